"""The house stands as it was drawn: who may import whom, what no module may do, what must agree."""

from __future__ import annotations

import ast
import importlib
import json
import re
import subprocess
import sys
import types
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Collection
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).parents[1]
SOURCES = ROOT / "ros_ws" / "src"

# package -> ours that it may import. An estimator that can reach the simulator can reach the truth.
MAY_IMPORT = {
    "tms_model": set(),
    "tms_bag": {"tms_model"},
    "tms_sim": {"tms_bag", "tms_model"},
    "tms_fit": {"tms_bag", "tms_model"},
    "tms_calibrate": {"tms_bag", "tms_fit", "tms_model"},
    "tms_study": {"tms_bag", "tms_calibrate", "tms_fit", "tms_model", "tms_sim"},
}
PACKAGES = sorted(MAY_IMPORT)
MODULES = sorted(path for package in PACKAGES for path in (SOURCES / package / package).rglob("*.py"))

# What a name that is imported is called by rosdep, where the two differ. mcap, zstandard and lz4 have no key
# of their own.
ROSDEP_KEYS = {
    "filterpy": "python3-filterpy-pip",
    "lz4": "mcap-ros2-support",
    "matplotlib": "python3-matplotlib",
    "mcap": "mcap-ros2-support",
    "numpy": "python3-numpy",
    "rosbags": "python3-rosbags-pip",
    "scipy": "python3-scipy",
    "tqdm": "python3-tqdm",
    "yaml": "python3-yaml",
    "zstandard": "mcap-ros2-support",
}
# rosdep has no key for these; README says how they come.
NOT_IN_ROSDEP = {"imufusion", "vl_convert"}
# What a name that is imported is called by pip, where the two differ.
PIP_NAMES = {"vl_convert": "vl-convert-python", "yaml": "PyYAML"}


def name_of(path: Path) -> str:
    return str(path.relative_to(SOURCES))


def package_of(path: Path) -> str:
    return path.relative_to(SOURCES).parts[0]


def module_of(path: Path) -> str:
    parts = path.relative_to(SOURCES / package_of(path)).with_suffix("").parts
    return ".".join(parts).removesuffix(".__init__")


@cache
def nodes_of(path: Path) -> tuple[ast.AST, ...]:
    """All nodes of a file's syntax tree."""
    return tuple(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))


@cache
def imported(path: Path) -> tuple[str, ...]:
    """Full names of all modules that a file imports, at its top or inside a function."""
    names: list[str] = []
    for node in nodes_of(path):
        if isinstance(node, ast.Import):
            names += (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            names.append(source_of(node, path))
    return tuple(names)


def source_of(node: ast.ImportFrom, path: Path) -> str:
    """Full name of the module that a from-import in a file takes names from."""
    own = path.relative_to(SOURCES / package_of(path)).with_suffix("").parts
    above = own[: len(own) - node.level] if node.level else ()
    return ".".join((*above, *(node.module or "").split(".")))


def offenders(offences: Callable[[Path], Collection[str]]) -> dict[str, Collection[str]]:
    """What each module does against a rule, by module; empty where all keep it."""
    return {name_of(path): found for path in MODULES if (found := offences(path))}


def is_ros(module: str) -> bool:
    """rclpy and its relatives, or a package of messages."""
    top = module.partition(".")[0]
    return top.startswith(("rclpy", "rosidl")) or top.endswith(("_msgs", "_interfaces"))


def test_there_is_something_to_look_at() -> None:
    assert {package_of(path) for path in MODULES} == set(PACKAGES)
    assert len(MODULES) > 40
    folders = {path.parent.name for path in SOURCES.glob("*/package.xml")}
    assert folders == {*PACKAGES, "tms_msgs"}  # a new package: say above what it may import


def test_imports_point_one_way() -> None:
    def forbidden(path: Path) -> set[str]:
        ours = {module.partition(".")[0] for module in imported(path)} & set(PACKAGES)
        return ours - {package_of(path)} - MAY_IMPORT[package_of(path)]

    assert offenders(forbidden) == {}


Dotted = tuple[str, ...]  # parts of a module's full name, __init__ among them


def inside(path: Path, known: Collection[Dotted]) -> set[Dotted]:
    """Modules of `known` that a file imports, at its top, inside a function or for its types."""
    found: set[Dotted] = set()
    for node in nodes_of(path):
        if isinstance(node, ast.Import):
            candidates = [(alias.name,) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):  # of `from a import b`, b is a module or a name in a
            source = source_of(node, path)
            candidates = [(f"{source}.{alias.name}", source) for alias in node.names]
        else:
            continue
        for names in candidates:
            parts = [tuple(name.split(".")) for name in names]
            found |= set([one for part in parts for one in (part, (*part, "__init__")) if one in known][:1])
    return found


def import_graphs(package: str) -> dict[Dotted, dict[str, set[str]]]:
    """By folder: what each module and sub-folder in it, with all that it holds, imports of the others."""
    modules = {
        path.relative_to(SOURCES / package).with_suffix("").parts: path
        for path in MODULES
        if package_of(path) == package
    }
    graphs: dict[Dotted, dict[str, set[str]]] = {}
    for name, path in modules.items():
        if name == (package, "__init__"):  # re-exports the public API
            continue
        for other in inside(path, modules) - {name}:
            depth = next(k for k, (mine, its) in enumerate(zip(name, other, strict=False)) if mine != its)
            graphs.setdefault(name[:depth], {}).setdefault(name[depth], set()).add(other[depth])
    return graphs


@pytest.mark.parametrize("package", PACKAGES)
def test_no_import_runs_back_up(package: str) -> None:
    # Modules and sub-folders of a folder can be listed so that each imports only what stands before it.
    graphs = import_graphs(package)
    assert graphs
    for folder, graph in graphs.items():
        try:
            TopologicalSorter(graph).prepare()
        except CycleError as error:
            pytest.fail(f"{'.'.join(folder)}: {' <- '.join(error.args[1])}")


@pytest.mark.parametrize(
    "files",
    [
        {"one.py": "from tms_fit.two import b", "two.py": "def b() -> None:\n    import tms_fit.one\n"},
        {"a/one.py": "from tms_fit.b import two", "b/two.py": "", "b/three.py": "from ..a.one import x"},
        {"a/one.py": "from tms_fit import two", "two.py": "from tms_fit import a", "a/__init__.py": ""},
    ],
    ids=["modules", "folders", "module and folder"],
)
def test_an_import_that_runs_back_up_is_found(
    files: dict[str, str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    modules = [tmp_path / "tms_fit" / "tms_fit" / name for name in files]
    for module, text in zip(modules, files.values(), strict=True):
        module.parent.mkdir(parents=True, exist_ok=True)
        module.write_text(text)
    monkeypatch.setitem(globals(), "SOURCES", tmp_path)
    monkeypatch.setitem(globals(), "MODULES", modules)
    with pytest.raises(pytest.fail.Exception, match="tms_fit: "):
        test_no_import_runs_back_up("tms_fit")


def test_only_nodes_know_ros() -> None:
    def ros(path: Path) -> list[str]:
        return [m for m in imported(path) if "nodes" not in path.parts and (is_ros(m) or ".nodes" in m)]

    assert offenders(ros) == {}


def test_everything_but_the_nodes_works_without_ros() -> None:
    # With rclpy and all messages out of reach, every module outside nodes/ can be imported.
    names = [module_of(path) for path in MODULES if "nodes" not in path.parts and path.name != "__main__.py"]
    program = (
        "import sys, importlib\n"
        "class Wall:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        "        top = name.partition('.')[0]\n"
        "        if top.startswith('rclpy') or top.endswith(('_msgs', '_interfaces')):\n"
        "            raise ImportError(f'{name} is out of reach')\n"
        "sys.meta_path.insert(0, Wall())\n"
        f"for name in {names!r}: importlib.import_module(name)\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_no_module_is_a_drawer() -> None:
    # A name says what a module is about.
    drawer = re.compile(r"(utils?|common|core|helpers?|misc|tools?)")
    assert (
        offenders(
            lambda path: [p for p in path.relative_to(SOURCES).with_suffix("").parts if drawer.fullmatch(p)]
        )
        == {}
    )


def dangers(path: Path) -> list[str]:
    """Calls and imports by which something that is read could run."""
    unsafe = {"pickle", "cPickle", "marshal", "shelve", "dill"}
    found = [module for module in imported(path) if module.partition(".")[0] in unsafe]
    for call in (node for node in nodes_of(path) if isinstance(node, ast.Call)):
        called = ast.unparse(call.func)
        values = {keyword.arg: keyword.value for keyword in call.keywords}
        shell = values.get("shell", ast.Constant(False))
        if (
            called in ("eval", "exec", "compile", "os.system", "os.popen", "__import__")
            or called in ("yaml.unsafe_load", "yaml.full_load", "yaml.load_all")
            or (called == "yaml.load" and not is_safe(path, ast.unparse(values["Loader"])))
            or (called in ("np.load", "numpy.load") and "allow_pickle" in values)
            or not (isinstance(shell, ast.Constant) and shell.value is False)
        ):
            found.append(ast.unparse(call))
    return found


def is_safe(path: Path, loader: str) -> bool:
    """Whether a module's loader of YAML makes plain values only."""
    found = getattr(importlib.import_module(module_of(path)), loader)
    return issubclass(found, yaml.constructor.SafeConstructor) and not issubclass(
        found, yaml.constructor.FullConstructor
    )


def test_nothing_that_is_read_can_run() -> None:
    assert offenders(dangers) == {}


def test_randomness_is_an_argument() -> None:
    # Same seed, same bytes: no module draws from a generator of the whole process, or seeds one of its own.
    def hidden(path: Path) -> list[str]:
        of_the_process = re.findall(
            r"np\.random\.(?!Generator|default_rng\([^)])\w*", path.read_text(encoding="utf-8")
        )
        return [*({"random"} & set(imported(path))), *of_the_process]

    assert offenders(hidden) == {}


@pytest.mark.parametrize(
    ("text", "rule"),
    [
        ("from tms_sim.run import simulate", test_imports_point_one_way),
        ("from tms_bag.nodes import recorder", test_only_nodes_know_ros),
        ("def f():\n    import rclpy", test_only_nodes_know_ros),
        ("import pickle", test_nothing_that_is_read_can_run),
        ("eval('1')", test_nothing_that_is_read_can_run),
        ("np.load(path, allow_pickle=True)", test_nothing_that_is_read_can_run),
        ("subprocess.run(line, shell=True)", test_nothing_that_is_read_can_run),
        ("yaml.load(text, Loader=Loader)", test_nothing_that_is_read_can_run),
        ("import random", test_randomness_is_an_argument),
        ("np.random.normal()", test_randomness_is_an_argument),
        ("np.random.default_rng()", test_randomness_is_an_argument),
    ],
)
def test_the_rules_find_what_breaks_them(
    text: str, rule: Callable[[], None], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    module = tmp_path / "tms_fit" / "tms_fit" / "offending.py"
    module.parent.mkdir(parents=True)
    module.write_text(text)
    monkeypatch.setitem(globals(), "SOURCES", tmp_path)
    monkeypatch.setitem(globals(), "MODULES", [module])
    loaded = types.SimpleNamespace(Loader=yaml.FullLoader)
    monkeypatch.setitem(sys.modules, "tms_fit.offending", loaded)
    with pytest.raises(AssertionError, match=r"offending\.py"):
        rule()


def tree(package: str) -> ElementTree.Element:
    return ElementTree.parse(SOURCES / package / "package.xml").getroot()


def setup_arguments(package: str) -> dict[str, ast.expr]:
    """Keyword arguments of the call of setup() in a package's setup.py."""
    module = ast.parse((SOURCES / package / "setup.py").read_text())
    (call,) = (
        node for node in ast.walk(module) if isinstance(node, ast.Call) and ast.unparse(node.func) == "setup"
    )
    return {keyword.arg: keyword.value for keyword in call.keywords if keyword.arg}


def version_in(pattern: str, path: Path) -> str:
    found = re.search(pattern, path.read_text(encoding="utf-8"), re.MULTILINE)
    assert found, f"no version in {path}"
    return found.group(1)


def test_versions_agree() -> None:
    versions = {
        "CHANGELOG.md": version_in(r"^## (\d+\.\d+\.\d+)", ROOT / "CHANGELOG.md"),
        "pyproject.toml": version_in(r'^version = "(.+)"', ROOT / "pyproject.toml"),
    }
    for folder in sorted(path.parent.name for path in SOURCES.glob("*/package.xml")):
        versions[f"{folder}/package.xml"] = tree(folder).findtext("version") or ""
    for package in PACKAGES:
        versions[f"{package}/setup.py"] = ast.literal_eval(setup_arguments(package)["version"])
        versions[f"{package}/__init__.py"] = version_in(
            r'^__version__ = "(.+)"', SOURCES / package / package / "__init__.py"
        )
    assert len(set(versions.values())) == 1, json.dumps(versions, indent=1)


@pytest.mark.parametrize("package", PACKAGES)
def test_package_xml_names_what_is_imported(package: str) -> None:
    # What rosdep installs is what runs: nothing that is imported may be missing there.
    tops = {
        module.partition(".")[0]
        for path in MODULES
        if package_of(path) == package
        for module in imported(path)
    }
    foreign = {top for top in tops if top not in sys.stdlib_module_names and top != package}
    depends = {element.text for element in tree(package) if element.tag in ("depend", "exec_depend")}
    assert {ROSDEP_KEYS.get(top, top) for top in foreign - NOT_IN_ROSDEP} <= depends
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert all(f"pip install {PIP_NAMES.get(top, top)}" in readme for top in foreign & NOT_IN_ROSDEP)


@pytest.mark.parametrize("package", PACKAGES)
def test_package_xml_names_nothing_that_nobody_needs(package: str) -> None:
    # Packages of messages stand there for their names in topics and types, too, which come from tms_bag.
    texts = "\n".join(
        p.read_text() for p in MODULES if package_of(p) in {package, *MAY_IMPORT[package] - {"tms_model"}}
    )
    texts += "\n".join(p.read_text() for p in (SOURCES / package / "launch").glob("*.py"))
    for element in tree(package):
        if element.tag in ("depend", "exec_depend"):
            names = [top for top, key in ROSDEP_KEYS.items() if key == element.text] or [str(element.text)]
            assert any(re.search(rf"\b{name}\b", texts) for name in names), element.text


@pytest.mark.parametrize("package", PACKAGES)
def test_setup_py_names_what_pip_must_bring(package: str) -> None:
    required = {
        re.split(r"[<>=!~ \[]", item)[0].lower()
        for item in ast.literal_eval(setup_arguments(package)["install_requires"])
    }
    tops = {
        module.partition(".")[0]
        for path in MODULES
        if package_of(path) == package
        for module in imported(path)
    }
    pip = {PIP_NAMES.get(top, top).lower() for top in tops if top in {*ROSDEP_KEYS, *NOT_IN_ROSDEP}}
    assert pip <= required


@pytest.mark.parametrize("package", PACKAGES)
def test_data_files_are_installed_with_the_package(package: str) -> None:
    # A bicycle, a sensor, a scenario or a mapping is one YAML file; it must not stay behind.
    folder = SOURCES / package / package
    there = {p for p in folder.rglob("*") if p.is_file() and p.suffix not in (".py", ".pyc")}
    module = ast.parse((SOURCES / package / "setup.py").read_text())
    patterns = [
        node.value
        for node in ast.walk(module)
        if isinstance(node, ast.Constant)
        and isinstance(node.value, str)
        and ("*" in node.value or "." in node.value)
    ]
    matched = {p for pattern in patterns if not pattern.startswith("/") for p in folder.glob(pattern)}
    assert there <= matched
    assert folder / "py.typed" in there


@pytest.mark.parametrize("package", PACKAGES)
def test_package_xml_is_complete(package: str) -> None:
    root = tree(package)
    assert root.findtext("name") == package
    assert root.findtext("license") == "Apache-2.0"
    assert len(root.findtext("description") or "") > 20
    assert root.findtext("export/build_type") == "ament_python"
    assert (SOURCES / package / "resource" / package).is_file()
