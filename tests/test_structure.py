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
    "lives",
    "analysis",
    "pages",
    "compare",
    "cli",
)
# What each package of the root may import: models <- tasks <- protocols -> controller.
ROOT_LAYERS = {
    "models": {"models", "fields"},
    "tasks": {"models", "tasks", "fields", "gymnasium_registration"},
    "controller": {"controller", "fields"},
    "protocols": {*PACKAGES, "fields"},
}
MOST_LINES, MOST_MODULES, MOST_PARAMETERS = 450, 20, 6
MOST_MODULES_OF_PROTOCOLS, MOST_FOLDERS_OF_PROTOCOLS = 90, 7
MOST_LEVELS, MOST_LEVELS_OF_PROTOCOLS = 18, 14


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
    """Returns the line and the module of each import of a module from this package.

    Args:
      name: Name of the module.
      top: Whether to return only imports that run when the module is imported.
      typing: Whether to return those behind "if TYPE_CHECKING:", too.
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
    """Returns the number of a module of protocols' layer; None for the package's own file."""
    parts = name.split(".")[1:]
    if not parts:
        return None
    numbers = [n for n, entries in enumerate(LAYERS) if parts[0] in entries.split()]
    assert numbers, f"{place(name)} is in no layer of {__file__}"
    return numbers[0]


def test_root_packages_import_only_what_they_may():
    wrong = [
        f"{place(name, line)}: {name.split('.')[0]} imports {target}"
        for name in modules()
        if name.split(".")[0] in PACKAGES
        for line, target in imports(name)
        if target and target.split(".")[0] not in ROOT_LAYERS[name.split(".")[0]]
    ]
    assert not wrong, "\n".join(wrong)


def test_no_layer_of_protocols_imports_a_higher_one():
    wrong = []
    for name in modules():
        if not name.startswith("protocols.") or (own := layer(name)) is None:
            continue
        for line, target in imports(name):
            if target.startswith("protocols.") and layer(target) > own:
                wrong.append(f"{place(name, line)}: {name} imports {target}, a higher layer")
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


@pytest.mark.parametrize(
    ("package", "most"), [("", MOST_LEVELS), ("protocols", MOST_LEVELS_OF_PROTOCOLS)]
)
def test_the_longest_chain_of_imports_is_short(package, most):
    chain = longest_chain({name for name in modules() if name.startswith(package)})
    assert len(chain) <= most, f"{len(chain)} levels:\n" + "\n".join(map(place, chain))


# Sizes


def test_no_module_is_too_long():
    lengths = {name: len(path.read_text().splitlines()) for name, path in modules().items()}
    wrong = [
        f"{place(n)}:{MOST_LINES + 1}: {k} lines" for n, k in lengths.items() if k > MOST_LINES
    ]
    assert not wrong, "\n".join(wrong)


def test_no_folder_has_too_many_modules_and_protocols_not_too_many_folders():
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
    root = {path for path in modules().values() if path.parent == ROOT and path.stem != "fields"}
    assert sorted(found) == sorted({*modules().values()} - root)


def public_functions(path):
    """Yields the public functions of a module and the public methods of its public classes."""
    for node in tree(path).body:
        if isinstance(node, ast.FunctionDef) and not node.name.startswith("_"):
            yield node, node.args.posonlyargs + node.args.args + node.args.kwonlyargs
        if isinstance(node, ast.ClassDef):
            for method in node.body:
                if not isinstance(method, ast.FunctionDef):
                    continue
                if method.name.startswith("_") and method.name not in ("__init__", "__call__"):
                    continue
                arguments = method.args.posonlyargs + method.args.args
                static = any(ast.unparse(d) == "staticmethod" for d in method.decorator_list)
                yield method, arguments[not static :] + method.args.kwonlyargs


def test_no_public_function_has_too_many_parameters():
    wrong = [
        f"{place(name, function.lineno)}: {function.name} has {len(parameters)} parameters"
        for name, path in modules().items()
        for function, parameters in public_functions(path)
        if len(parameters) > MOST_PARAMETERS
    ]
    assert not wrong, "\n".join(wrong)
