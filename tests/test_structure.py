"""The structure of the package: its layers and its sizes, read from the files alone."""

import ast
import functools
import graphlib
from collections import Counter
from pathlib import Path

import pytest
from mutants import AREAS

ROOT = Path(__file__).parents[1]
PACKAGES = ("models", "tasks", "controller", "protocols")

# Folders and modules of `protocols`, lowest first: each imports only its own entry and lower ones.
LAYERS = (
    "errors examples exit_status machine progress storage terminal",
    "agents",
    "runs",
    "analysis",
    "pages",
    "compare",
    "cli",
)
# What each package of the root may import: models <- tasks <- protocols -> controller.
ROOT_LAYERS = {
    "models": {"models", "fields", "extras"},
    "tasks": {
        "models",
        "tasks",
        "fields",
        "compiled_equations",
        "extras",
        "gymnasium_registration",
    },
    "controller": {"controller", "fields", "compiled_equations", "extras"},
    "protocols": {*PACKAGES, "fields", "compiled_equations", "extras"},
}
MOST_LINES, MOST_MODULES, MOST_PARAMETERS = 450, 20, 6
MOST_MODULES_OF_PROTOCOLS, MOST_FOLDERS_OF_PROTOCOLS = 90, 7
MOST_LEVELS, MOST_LEVELS_OF_PROTOCOLS = 19, 14


@functools.cache
def modules():
    """Returns the path of every module of the package by its dotted name, "" for the root's."""
    files = [*ROOT.glob("*.py")]
    for package in PACKAGES:
        files += [path for path in (ROOT / package).rglob("*.py")]
    return {name_of(path): path for path in sorted(files) if path.name != "setup.py"}


def name_of(path):
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


@functools.cache
def tree(path):
    return ast.parse(path.read_text(), str(path))


def imports(name, top=False, typing=True):
    """Returns the line and module of each import from this package: all, the `top` ones, or those
    without "if TYPE_CHECKING:".
    """
    path = modules()[name]
    package = name.split(".")[: None if path.name == "__init__.py" else -1] if name else []
    found, nodes = [], tree(path).body if top else [*ast.walk(tree(path))]
    if not typing:
        blocks = [node for node in nodes if isinstance(node, ast.If)]
        behind = [b.body for b in blocks if "TYPE_CHECKING" in ast.unparse(b.test)]
        nodes = [node for node in nodes if not any(node in body for body in behind)]
    for node in nodes:
        if isinstance(node, ast.ImportFrom) and node.level:
            assert node.level - 1 <= len(package), f"{path}:{node.lineno}: above the package"
            base = package[: len(package) - node.level + 1]
            base = ".".join([*base, *filter(None, [node.module])])
            for alias in node.names:
                deeper = ".".join(filter(None, [base, alias.name]))
                found.append((node.lineno, deeper if deeper in modules() else base))
        elif isinstance(node, ast.Import | ast.ImportFrom):
            assert "musebot" not in ast.unparse(node), f"{path}:{node.lineno}: not relative"
    return [(line, target) for line, target in found if target != name]


def place(name, line=None):
    path = modules()[name].relative_to(ROOT)
    return f"{path}:{line}" if line else str(path)


# Imports


def layer(name):
    """Returns the number of a module of protocols' layer; -1 for what is outside of it."""
    first = name.partition("protocols.")[2].split(".")[0]
    numbers = [n for n, entries in enumerate(LAYERS) if first in entries.split()]
    assert numbers or not first, f"{place(name)} is in no layer of {__file__}"
    return numbers[0] if numbers else -1


def test_packages_and_layers_of_protocols_import_only_what_is_below_them():
    wrong = []
    for name in modules():
        own = name.split(".")[0]
        for line, target in imports(name) if own in PACKAGES else ():
            foreign = target and target.split(".")[0] not in ROOT_LAYERS[own]
            if foreign or layer(target) > layer(name) > -1:
                wrong.append(f"{place(name, line)}: {name} imports {target}")
    assert not wrong, "\n".join(wrong)


def test_no_import_closes_a_circle():
    graph = {name: {target for _, target in imports(name, top=True)} for name in modules()}
    try:
        graphlib.TopologicalSorter(graph).prepare()
    except graphlib.CycleError as error:
        pytest.fail(" -> ".join(map(place, error.args[1])))


def longest_chain(names):
    """Returns the longest chain of imports among some modules, from the highest to the lowest."""

    @functools.cache
    def chain(name):
        below = [chain(target) for _, target in imports(name, typing=False) if target in names]
        return (name, *max(below, key=len, default=()))

    return max(map(chain, sorted(names)), key=len)


def test_the_longest_chain_of_imports_is_short():
    for package, most in (("", MOST_LEVELS), ("protocols", MOST_LEVELS_OF_PROTOCOLS)):
        chain = longest_chain({name for name in modules() if name.startswith(package)})
        assert len(chain) <= most, f"{len(chain)} levels:\n" + "\n".join(map(place, chain))


# Sizes


def test_no_module_is_too_long_and_no_folder_has_too_many():
    lengths = {name: len(path.read_text().splitlines()) for name, path in modules().items()}
    assert {place(name): k for name, k in lengths.items() if k > MOST_LINES} == {}
    files = [path for path in modules().values() if path.name != "__init__.py"]
    folders = Counter(str(path.parent.relative_to(ROOT)) for path in files)
    assert {f: count for f, count in folders.items() if count > MOST_MODULES} == {}
    counts = [count for folder, count in folders.items() if folder.startswith("protocols")]
    assert sum(counts) <= MOST_MODULES_OF_PROTOCOLS
    below = {path.parent.name for path in (ROOT / "protocols").glob("*/__init__.py")}
    assert len(below) <= MOST_FOLDERS_OF_PROTOCOLS and len(LAYERS) <= MOST_FOLDERS_OF_PROTOCOLS


def test_every_module_is_in_one_area_of_mutants():
    found = [path for area in AREAS.values() for one in area.split() for path in ROOT.glob(one)]
    assert all(any(ROOT.glob(one)) for area in AREAS.values() for one in area.split())
    owned = ("fields", "compiled_equations")
    root = {p for p in modules().values() if p.parent == ROOT and p.stem not in owned}
    assert sorted(found) == sorted({*modules().values()} - root)


def public_functions(path):
    """Yields the public functions of a module and the public methods of its public classes."""
    for node in tree(path).body:
        inner = node.body if isinstance(node, ast.ClassDef) else [node]
        for function in inner:
            if isinstance(function, ast.FunctionDef):
                if not function.name.startswith("_") or function.name in ("__init__", "__call__"):
                    yield function, isinstance(node, ast.ClassDef)


def test_no_public_function_has_too_many_parameters():
    wrong = []
    for name, path in modules().items():
        for function, method in public_functions(path):
            own, decorators = function.args, map(ast.unparse, function.decorator_list)
            count = len(own.posonlyargs + own.args + own.kwonlyargs)
            if count - (method and "staticmethod" not in decorators) > MOST_PARAMETERS:
                wrong.append(f"{place(name, function.lineno)}: {function.name}")
    assert not wrong, "\n".join(wrong)
