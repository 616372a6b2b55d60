"""The next part of a file is read and unpacked while this one is decoded."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

Part = TypeVar("Part")


def in_advance(parts: Iterable[Callable[[], Part]]) -> Iterator[Part]:
    """Results of the calls in their order, each begun one ahead in another thread.

    Decompression and checksums let go of Python's lock, so that two cores work. Never more than two results
    are held.
    """
    with ThreadPoolExecutor(max_workers=1, thread_name_prefix="bag") as pool:
        begun: Future[Part] | None = None
        for part in parts:
            before, begun = begun, pool.submit(part)
            if before is not None:
                yield before.result()
        if begun is not None:
            yield begun.result()
