"""Read many mutated files of one kind: python tests/fuzz/batch.py TARGET FIRST_SEED COUNT.

One JSON document: how many were read, the slowest, the memory, and what went wrong with which seed. A file
that takes longer than two seconds is a defect.
"""

from __future__ import annotations

import json
import re
import signal
import sys
import time
import warnings
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

import numpy as np
from mutations import mutated
from targets import TARGETS, read

LIMIT = 2.0  # [s] for one file


class TooSlow(BaseException):
    """Not an Exception, so that nobody takes it for a damaged file."""


def main(name: str, first: int, count: int) -> dict[str, object]:
    """Read files first, first + 1, ..."""
    signal.signal(signal.SIGPROF, _too_slow)
    warnings.simplefilter("ignore")
    seeds, defects, slowest = TARGETS[name].seeds(), [], 0.0
    for seed in seeds:
        read(name, seed)
    before = peak_memory()
    for number in range(first, first + count):
        data = mutated(seeds, np.random.default_rng(number))
        start = time.process_time()
        signal.setitimer(signal.ITIMER_PROF, LIMIT)
        try:
            read(name, data)
        except BaseException as error:
            if isinstance(error, KeyboardInterrupt):
                raise
            defects.append({"seed": number, "error": f"{type(error).__name__}: {error}"[:300]})
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0.0)
        slowest = max(slowest, time.process_time() - start)
    peak = peak_memory()
    return {
        "target": name,
        "files": count,
        "slowest": slowest,
        "memory_mib": peak / 1024,
        "memory_before_mib": before / 1024,
        "defects": defects,
    }


def peak_memory() -> int:
    """Most memory that this process has had [KiB]; getrusage's counts the parent's before the start too."""
    found = re.search(r"VmHWM:\s+(\d+) kB", Path("/proc/self/status").read_text())
    assert found
    return int(found[1])


def _too_slow(*_: object) -> None:
    raise TooSlow(f"more than {LIMIT} s")


if __name__ == "__main__":
    print(json.dumps(main(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]))))
