import importlib.util
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
LOCK = (ROOT / "requirements/lock.txt").read_text()


def pins() -> list[str]:
    """The lock file's requirements, each joined to one line."""
    text = re.sub(r"^\s*#.*\n", "", LOCK, flags=re.MULTILINE).replace("\\\n", " ")
    return [line for line in text.splitlines() if line.strip()]


def test_every_pin_is_exact_and_hashed():
    assert len(pins()) > 100
    for pin in pins():
        assert re.match(r"[A-Za-z0-9._-]+==[0-9][^ ]*( ; [^-]*)?\s+--hash=sha256:[0-9a-f]{64}", pin), pin[:80]


def test_the_lock_names_no_place_of_its_own():
    """Where packages come from is the user's own setting; the paths of another machine mean nothing here."""
    assert re.findall(r"https?:|--index|--find-links|file:|/home|/root|/tmp", LOCK) == []


def test_every_direct_requirement_is_pinned():
    text = (ROOT / "pyproject.toml").read_text()
    wanted = {
        re.split(r"[<>=\[]", entry)[0].lower()
        for block in re.findall(
            r"^(?:dependencies|ros|dev) = \[\n(.*?)^\]", text, flags=re.MULTILINE | re.DOTALL
        )
        for entry in re.findall(r'^ +"([^"]+)"', block, flags=re.MULTILINE)
    }
    assert {"numpy", "rosbags", "pytest", "empy"} <= wanted
    assert wanted - {pin.split("==")[0].lower() for pin in pins()} == set()


def test_what_has_no_wheels_is_known_to_both_scripts_and_pinned():
    make_lock, tms = ((ROOT / name).read_text() for name in ("requirements/make_lock", "tms"))
    making = re.search(r"^from_source=\(([^)]+)\)", make_lock, re.MULTILINE)
    installing = re.search(r"^FROM_SOURCE=(\S+)", tms, re.MULTILINE)
    assert making
    assert installing
    assert making[1].split() == installing[1].split(",")
    assert set(making[1].split()) <= {pin.split("==")[0].lower() for pin in pins()}


@pytest.fixture
def mended():
    spec = importlib.util.spec_from_file_location("repair_wheels", ROOT / "requirements/repair_wheels.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.mended


def test_include_folders_of_the_build_container_become_local_ones(mended):
    container = "/opt/python/cp312-cp312"
    text = (
        f'INTERFACE_INCLUDE_DIRECTORIES "${{_IMPORT_PREFIX}}/include/std_msgs;{container}/include/python3.12;'
        f'{container}/lib/python3.12/site-packages/numpy/_core/include"\n'
    )
    own = "${_IMPORT_PREFIX}/include/std_msgs"
    expected = f'INTERFACE_INCLUDE_DIRECTORIES "{own};/a/b c/include;/numpy/include"\n'
    assert mended(text, "/a/b c/include", "/numpy/include") == expected
    assert mended(expected, "/other", "/other") == expected


def test_an_unknown_folder_of_the_build_container_is_an_error(mended):
    with pytest.raises(ValueError, match="no local folder is known for /opt/python/cp312"):
        mended('"/opt/python/cp312-cp312/lib/libpython3.12.a"', "/a", "/b")
