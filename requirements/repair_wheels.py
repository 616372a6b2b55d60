"""Mends the CMake files of the ROS wheels in the environment of the Python that runs this.

The wheels were built in a container, and their exported CMake files name that container's include folders of
Python and NumPy (/opt/python/cp311-cp311/...), which don't exist here: CMake then stops with 'includes
non-existent path'.
"""

import re
import sys
import sysconfig
from pathlib import Path

import numpy

FOREIGN = re.compile(r"/opt/python/[^;\"\s]*")


def mended(text: str, python_include: str, numpy_include: str) -> str:
    """The text of a CMake file with this interpreter's include folders in place of the build container's."""

    def local(match: "re.Match[str]") -> str:
        if match[0].endswith("/site-packages/numpy/_core/include"):
            return numpy_include
        if re.search(r"/include/python3\.\d+$", match[0]):
            return python_include
        raise ValueError(f"no local folder is known for {match[0]}")

    return FOREIGN.sub(local, text)


def main() -> None:
    """Rewrites what needs it below share/; running it again changes nothing."""
    python_include = sysconfig.get_paths()["include"]
    count = 0
    for path in sorted((Path(sys.prefix) / "share").rglob("*.cmake")):
        text = path.read_text(encoding="utf-8")
        repaired = mended(text, python_include, numpy.get_include())
        if repaired != text:
            path.write_text(repaired, encoding="utf-8")
            count += 1
    print(f"mended {count} CMake files")


if __name__ == "__main__":
    main()
