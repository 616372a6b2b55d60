"""Coverage-guided fuzzing of one kind of file, by atheris: python tests/fuzz/fuzz.py TARGET [-runs=100000].

What follows the target goes to libFuzzer. A file that breaks something is left as crash-..., one that takes
more than two seconds as timeout-...; both belong into tests/fuzz/corpus/TARGET once they are mended.
"""

from __future__ import annotations

import sys
import tempfile
import warnings
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

import atheris

with atheris.instrument_imports(include=["tms_bag", "tms_model", "tms_sim", "mcap", "rosbags", "yaml"]):
    from targets import TARGETS, read


def main() -> None:
    """Seeds and the corpus first, then whatever the coverage leads to."""
    if len(sys.argv) < 2 or sys.argv[1] not in TARGETS:
        sys.exit(f"expected one of {', '.join(TARGETS)}, found {' '.join(sys.argv[1:2]) or 'nothing'}")
    name = sys.argv.pop(1)
    warnings.simplefilter("ignore")
    with tempfile.TemporaryDirectory() as folder:
        for number, seed in enumerate(TARGETS[name].seeds()):
            (Path(folder) / str(number)).write_bytes(seed)
        known = Path(__file__).parent / "corpus" / name
        folders = [folder, *([str(known)] if known.is_dir() else [])]
        options = ["-timeout=2", "-rss_limit_mb=512", "-max_len=65536"]
        # libFuzzer writes what it finds into the first folder: the temporary one.
        atheris.Setup([sys.argv[0], *options, *sys.argv[1:], *folders], lambda data: read(name, data))
        atheris.Fuzz()


if __name__ == "__main__":
    main()
