"""Changes of files: of their bytes, of their JSON and arrays, and of what they are."""

import json
import os
import pickle

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


def _cut(draw, data):
    at = draw.integers(len(data))
    return data[:at] + data[at + draw.integers(1, 200) :]


def _blank(draw, data):  # as after a crash
    start, stop = sorted(draw.integers(0, len(data) + 1, 2))
    return data[:start] + bytes(stop - start) + data[stop:]


class Bomb:
    """An object that makes a folder when it is unpickled."""

    def __reduce__(self):
        return os.mkdir, (os.environ["HOSTILE_MARK"],)


# tests/test_storage.py cuts a file and flips a bit at every byte.
BYTES = {
    "flip": _flip,
    "truncate": lambda draw, data: data[: draw.integers(len(data))],
    "extend": lambda draw, data: data + draw.bytes(int(draw.integers(1, 5000))),
    "cut": _cut,
    "blank": _blank,
    "noise": lambda draw, data: draw.bytes(int(draw.integers(0, len(data) + 1))),
    "pickled": lambda draw, data: pickle.dumps(Bomb()),
}


# ---- What stands in the place of a file, of a path and of the same file of another run ----


def _huge(path, other):
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
    return one(draw, (
        "null", "true", "false", "-1", "0", "1", "2", "0.5", "1.5", "1e400", "-1e400", "NaN",
        "Infinity", "-Infinity", "1" + "0" * 400, "9" * 5000, "1e-320", "18446744073709551616",
        '""', '"150"', '"' + "x" * n + '"', '"\\u0000"', '"\\ud800"', '"\\u202e"', '"__import__"',
        "[]", "{}", "[[]]", "[0]", '{"a": 1}', "[" * n + "]" * n, "[" * 10**5 + "]" * 10**5,
        '{"a":' * n + "1" + "}" * n, "[" + "0," * n + "0]", '"os:system"', '"../../x"', "1e3",
        '"fixed"', '"spot_finding"', '"kinematic"', '"walls"', "3", "4", "-0.0", "1e308",
    ))  # fmt: skip


class Raw(str):
    """Text that stands in JSON as it is."""


def dumped(value):
    """Returns JSON with the texts of `Raw` in it, and with keys that may be given twice."""
    if isinstance(value, Raw):
        return str(value)
    if isinstance(value, dict):
        value = (*value.items(),)
    if isinstance(value, tuple):  # of pairs
        return "{" + ", ".join(f"{json.dumps(k)}: {dumped(v)}" for k, v in value) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(dumped, value)) + "]"
    return json.dumps(value)


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
    keys = [*place] if isinstance(place, dict) else range(len(place))
    key, what, new = one(draw, keys), draw.integers(6), Raw(hostile_value(draw))
    if what == 0:
        del place[key]
    elif what == 1 and isinstance(place, dict):
        place[one(draw, KEYS)] = place.pop(key)
    elif what == 2 and isinstance(place, dict):
        place[one(draw, KEYS)] = new
    elif what == 2:
        place.append(place[key])
    elif what == 3 and place is content:
        return dumped((*place.items(), (key, new))).encode()
    else:
        place[key] = new
    return dumped(content).encode()


KEYS = ("", "a", "seed ", "\x00", "__class__", "x" * 5000, "course", "young_epsilon", "🤖")
