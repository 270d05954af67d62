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


def flip(draw, data):
    """Flips 1 to 4 bits."""
    data = bytearray(data)
    for _ in range(draw.integers(1, 5)):
        data[draw.integers(len(data))] ^= 1 << int(draw.integers(8))
    return bytes(data)


def truncate(draw, data):
    """Cuts the end."""
    return data[: draw.integers(len(data))]


def extend(draw, data):
    """Appends bytes."""
    return data + draw.bytes(int(draw.integers(1, 5000)))


def insert(draw, data):
    """Inserts bytes."""
    at = draw.integers(len(data) + 1)
    return data[:at] + draw.bytes(int(draw.integers(1, 50))) + data[at:]


def cut(draw, data):
    """Removes bytes from within."""
    at = draw.integers(len(data))
    return data[:at] + data[at + draw.integers(1, 200) :]


def repeat(draw, data):
    """Repeats a part."""
    start, stop = sorted(draw.integers(0, len(data) + 1, 2))
    return data[:stop] + data[start:stop] + data[stop:]


def blank(draw, data):
    """Sets a part to zeros, as a file system does after a crash."""
    start, stop = sorted(draw.integers(0, len(data) + 1, 2))
    return data[:start] + bytes(stop - start) + data[stop:]


def noise(draw, data):
    """Replaces everything."""
    return draw.bytes(int(draw.integers(0, len(data) + 1)))


def bytes_of_text(draw, data):
    """Puts in what text must not contain, or what changes its meaning."""
    pieces = (b"\x00", b"\xff\xfe", b"\xef\xbb\xbf", "\u202e".encode(), b"\r", b"\x1b[2J", b"\xc3")
    at = draw.integers(len(data) + 1)
    return data[:at] + one(draw, pieces) + data[at:]


def pickled(draw, data):
    """Replaces everything by a pickle that makes a folder where it is loaded."""
    del draw, data
    return pickle.dumps(Bomb())


class Bomb:
    """An object that makes a folder when it is unpickled."""

    def __reduce__(self):
        return os.mkdir, (os.environ["HOSTILE_MARK"],)


BYTES = (
    flip,
    flip,
    flip,
    truncate,
    extend,
    insert,
    cut,
    repeat,
    blank,
    noise,
    bytes_of_text,
    pickled,
)


# ---- What stands in the place of a file ----


def no_file(draw, path, other):
    """Deletes the file."""
    del draw, other
    path.unlink()


def pipe(draw, path, other):
    """Puts a pipe there that nobody writes to."""
    del draw, other
    path.unlink()
    os.mkfifo(path)


def folder(draw, path, other):
    """Puts a folder there."""
    del draw, other
    path.unlink()
    path.mkdir()


def link_to_other(draw, path, other):
    """Puts a link to the same file of another run there."""
    del draw
    path.unlink()
    path.symlink_to(other)


def link_to_device(draw, path, other):
    """Puts a link to a device there."""
    del other
    path.unlink()
    path.symlink_to(("/dev/zero", "/dev/full", "/dev/null", "/dev/stdin")[draw.integers(4)])


def link_to_itself(draw, path, other):
    """Puts a link there that leads nowhere."""
    del draw, other
    path.unlink()
    path.symlink_to(path.name)


def huge(draw, path, other):
    """Makes the file huge, without blocks on the disk."""
    del draw, other
    os.truncate(path, HUGE)


PLACES = (no_file, pipe, folder, link_to_other, link_to_device, link_to_itself, huge)


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
    places = _containers(content)
    place = one(draw, places)
    if isinstance(place, dict):
        keys = [*place]
        key = one(draw, keys)
        what = draw.integers(6)
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
