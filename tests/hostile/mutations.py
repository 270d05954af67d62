"""Changes of files: of their bytes, of their JSON and arrays, and of what they are."""

import json
import os
import pickle
import struct

import numpy as np

HUGE = 2**30


def one(draw, values):
    """Draws one of several values."""
    return values[draw.integers(len(values))]


# ---- Bytes ----


def _flip(draw, data):
    data = bytearray(data)
    for _ in range(draw.integers(1, 5)):
        data[draw.integers(len(data))] ^= 1 << int(draw.integers(8))
    return bytes(data)


def _insert(draw, data, piece):
    at = draw.integers(len(data) + 1)
    return data[:at] + piece + data[at:]


def _cut(draw, data):
    at = draw.integers(len(data))
    return data[:at] + data[at + draw.integers(1, 200) :]


def _part(draw, data, change):
    start, stop = sorted(draw.integers(0, len(data) + 1, 2))
    return data[:start] + change(data[start:stop]) + data[stop:]


class Bomb:
    """An object that makes a folder when it is unpickled."""

    def __reduce__(self):
        return os.mkdir, (os.environ["HOSTILE_MARK"],)


# What text must not contain, or what changes its meaning.
NO_TEXT = (b"\x00", b"\xff\xfe", b"\xef\xbb\xbf", "\u202e".encode(), b"\r", b"\x1b[2J", b"\xc3")
BYTES = {
    "flip": _flip,
    "flip_again": _flip,
    "truncate": lambda draw, data: data[: draw.integers(len(data))],
    "extend": lambda draw, data: data + draw.bytes(int(draw.integers(1, 5000))),
    "insert": lambda draw, data: _insert(draw, data, draw.bytes(int(draw.integers(1, 50)))),
    "cut": _cut,
    "repeat": lambda draw, data: _part(draw, data, lambda part: part + part),
    "blank": lambda draw, data: _part(draw, data, lambda part: bytes(len(part))),  # after a crash
    "noise": lambda draw, data: draw.bytes(int(draw.integers(0, len(data) + 1))),
    "no_text": lambda draw, data: _insert(draw, data, one(draw, NO_TEXT)),
    "pickled": lambda draw, data: pickle.dumps(Bomb()),
}


# ---- What stands in the place of a file, of a path and of the same file of another run ----


def _huge(path, other):
    del other
    path.touch()
    os.truncate(path, HUGE)  # without blocks on the disk


PLACES = {
    "no_file": lambda path, other: None,
    "pipe": lambda path, other: os.mkfifo(path),
    "folder": lambda path, other: path.mkdir(),
    "link_to_other": lambda path, other: path.symlink_to(other),
    "link_to_itself": lambda path, other: path.symlink_to(path.name),
    "link_to_zeros": lambda path, other: path.symlink_to("/dev/zero"),
    "link_to_full": lambda path, other: path.symlink_to("/dev/full"),
    "link_to_stdin": lambda path, other: path.symlink_to("/dev/stdin"),
    "huge": _huge,
}


# ---- JSON ----


def hostile_value(draw):
    """Returns a text of JSON that is no sound value of most fields."""
    n = int(draw.integers(1, 2000))
    values = (
        "null", "true", "false", "-1", "0", "1", "2", "0.5", "1.5", "1e400", "-1e400", "NaN",
        "Infinity", "-Infinity", "1" + "0" * 400, "9" * 5000, "1e-320", "18446744073709551616",
        '""', '"150"', '"' + "x" * n + '"', '"\\u0000"', '"\\ud800"', '"\\u202e"', '"__import__"',
        "[]", "{}", "[[]]", "[0]", '{"a": 1}', "[" * n + "]" * n, "[" * 10**5 + "]" * 10**5,
        '{"a":' * n + "1" + "}" * n, "[" + "0," * n + "0]", '"os:system"', '"../../x"', "1e3",
        '"fixed"', '"spot_finding"', '"kinematic"', '"walls"', "3", "4", "-0.0", "1e308",
    )  # fmt: skip
    return one(draw, values)


class Raw(str):
    """Text that stands in JSON as it is."""


def dumped(value):
    """Returns JSON with the texts of `Raw` in it, and with keys that may be given twice."""
    if isinstance(value, Raw):
        return str(value)
    if isinstance(value, Pairs):
        return "{" + ", ".join(f"{json.dumps(k)}: {dumped(v)}" for k, v in value.pairs) + "}"
    if isinstance(value, dict):
        return dumped(Pairs([*value.items()]))
    if isinstance(value, list):
        return "[" + ", ".join(map(dumped, value)) + "]"
    return json.dumps(value)


class Pairs:
    """An object of JSON whose keys may repeat."""

    def __init__(self, pairs):
        self.pairs = pairs


def _containers(value):
    found = [value] if isinstance(value, dict | list) and value else []
    for child in value.values() if isinstance(value, dict) else value if found else ():
        if isinstance(child, dict | list):
            found += _containers(child)
    return found


def json_mutated(draw, data):
    """Changes one value, key or entry of a text of JSON, or nests it."""
    content = json.loads(data)
    if draw.random() < 0.03:
        n = int(draw.integers(1, 2 * 10**5))
        return b'{"a":' * n + data + b"}" * n
    if draw.random() < 0.03:
        return hostile_value(draw).encode()
    place = one(draw, _containers(content))
    if isinstance(place, dict):
        key, what = one(draw, [*place]), draw.integers(6)
        if what == 0:
            del place[key]
        elif what == 1:
            place[hostile_key(draw)] = place.pop(key)
        elif what == 2:
            place[hostile_key(draw)] = Raw(hostile_value(draw))
        elif what == 3 and place is content:
            return dumped(Pairs([*place.items(), (key, Raw(hostile_value(draw)))])).encode()
        else:
            place[key] = Raw(hostile_value(draw))
    else:
        at = draw.integers(len(place))
        what = draw.integers(4)
        if what == 0:
            del place[at]
        elif what == 1:
            place.append(place[at])
        else:
            place[at] = Raw(hostile_value(draw))
    return dumped(content).encode()


def hostile_key(draw):
    """Returns a name of a field that is none."""
    names = ("", "a", "seed ", "\x00", "__class__", "x" * 5000, "course", "young_epsilon", "🤖")
    return one(draw, names)


# ---- Arrays ----


def array_mutated(draw, array):
    """Returns an array of other values, another shape or dtype."""
    what = draw.integers(16)
    array = np.array(array)
    if not array.ndim and what > 11:
        array = array[None]
    at = tuple(draw.integers(n) for n in array.shape)
    if what < 5 and array.size:
        values = (np.nan, np.inf, -np.inf, -1, 2, 1.0001, 1e30, 30000, 0.5, 1e-40, -0.0)
        with np.errstate(all="ignore"):
            value = one(draw, values)
            if array.dtype.kind == "f" or np.isfinite(value):
                array[at] = np.array(value).astype(array.dtype)
    elif what < 10:
        kinds = (complex, float, np.float16, np.int64, np.uint8, bool, "U8", "S8", ">f4", "M8[s]")
        with np.errstate(all="ignore"):
            array = np.nan_to_num(array).astype(one(draw, kinds))
    elif what == 10:
        array = np.array(array.ravel()[:1].sum())
    elif what == 11:
        array = array[None]
    elif what == 12:
        array = array[:-1]
    elif what == 13:
        array = np.concatenate([array, array])
    elif what == 14:
        array = array.reshape(-1)
    else:
        array = array[..., :-1] if array.ndim > 1 else array[:0]
    return array


def tensors_header(data):
    """Returns the header of a safetensors file as JSON, and what follows it."""
    size = struct.unpack("<Q", data[:8])[0]
    return json.loads(data[8 : 8 + size]), data[8 + size :]


def with_header(text, rest):
    """Returns a safetensors file of a header and what follows it."""
    return struct.pack("<Q", len(text)) + text + rest


def tensors_mutated(draw, data):
    """Changes the header of a safetensors file; its digest stays."""
    header, rest = tensors_header(data)
    names = [name for name in header if name != "__metadata__"]
    entry = header[one(draw, names)]
    what = draw.integers(9)
    if what == 0:
        shapes = ([10**12], [2**63, 2], [-1], [], [0], "x", [1.5])
        entry["shape"] = one(draw, shapes)
    elif what == 1:
        offsets = ([0, 2**40], [2**62, 2**63], [-4, 0], [0, 0], [8, 4], [])
        entry["data_offsets"] = one(draw, offsets)
    elif what == 2:
        kinds = ("F64", "F16", "I32", "BOOL", "F8_E4M3", "X", "", "BF16")
        entry["dtype"] = one(draw, kinds)
    elif what == 3:
        other = header[one(draw, names)]
        entry["data_offsets"], other["data_offsets"] = other["data_offsets"], entry["data_offsets"]
    elif what == 4:
        sizes = (2**63 - 1, 2**64 - 1, 2**40, 0, 7, 10**8)
        return struct.pack("<Q", one(draw, sizes)) + data[8:]
    elif what == 5:
        return with_header(json_mutated(draw, json.dumps(header).encode()), rest)
    elif what == 6:
        header["__metadata__"] = {"musebot": hostile_value(draw)}
    elif what == 7:
        at = draw.integers(len(rest))
        rest = rest[:at] + bytes([rest[at] ^ (1 << int(draw.integers(8)))]) + rest[at + 1 :]
    else:
        header["new"] = {"dtype": "F32", "shape": [1], "data_offsets": [len(rest), len(rest) + 4]}
        rest += draw.bytes(4)
    return with_header(json.dumps(header).encode(), rest)
