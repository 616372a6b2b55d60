"""Good files made bad: the same generator state, the same damage."""

from __future__ import annotations

import struct

import numpy as np

# Lengths, counts and times that break programs.
NUMBERS = (0, 1, 0x7F, 0x80, 0xFF, 2**16 - 1, 2**31 - 1, 2**31, 2**32 - 1, 2**40, 2**63 - 1, 2**63, 2**64 - 1)
WORDS = (
    b"nan", b"inf", b"-", b"1e999", b"9" * 40, b"\n", b"\r\n\r\n", b",", b";", b'"', b"'", b"\x00",
    b"\xff\xfe", b"*a", b"&a ", b"!!python/object/apply:os.system ['true']", b": ", b"- ", b"[", b"{",
    b"../", b"/etc/passwd", b"=", b"null", b"true", b"[" * 500, b"{a: " * 200, b"<<: *a", b"? ", b"1e3",
    b"0x10", b"~", b"2026-01-01", b"!!binary x", b"!!timestamp x", b"&x [*x]",
)  # fmt: skip


def mutated(seeds: list[bytes], rng: np.random.Generator) -> bytes:
    """One of the seeds with one to six damages."""
    data = bytearray(seeds[int(rng.integers(len(seeds)))])
    for _ in range(int(rng.integers(1, 7))):
        data = _DAMAGES[int(rng.integers(len(_DAMAGES)))](data, seeds, rng)
    return bytes(data)


def _place(data: bytearray, rng: np.random.Generator) -> int:
    return int(rng.integers(len(data) + 1))


def _flip(data: bytearray, seeds: list[bytes], rng: np.random.Generator) -> bytearray:
    if data:
        data[int(rng.integers(len(data)))] ^= 1 << int(rng.integers(8))
    return data


def _byte(data: bytearray, seeds: list[bytes], rng: np.random.Generator) -> bytearray:
    if data:
        data[int(rng.integers(len(data)))] = int(rng.integers(256))
    return data


def _number(data: bytearray, seeds: list[bytes], rng: np.random.Generator) -> bytearray:
    value = NUMBERS[int(rng.integers(len(NUMBERS)))]
    size = (2, 4, 8)[int(rng.integers(3))]
    place = _place(data, rng)
    data[place : place + size] = struct.pack("<Q", value)[:size]
    return data


def _near(data: bytearray, seeds: list[bytes], rng: np.random.Generator) -> bytearray:
    """A length that is nearly right."""
    place = _place(data, rng)
    if place + 4 <= len(data):
        value = struct.unpack_from("<I", data, place)[0] + int(rng.integers(-16, 17))
        struct.pack_into("<I", data, place, value % 2**32)
    return data


def _cut(data: bytearray, seeds: list[bytes], rng: np.random.Generator) -> bytearray:
    return data[: _place(data, rng)]


def _remove(data: bytearray, seeds: list[bytes], rng: np.random.Generator) -> bytearray:
    place = _place(data, rng)
    del data[place : place + int(rng.integers(1, 40))]
    return data


def _repeat(data: bytearray, seeds: list[bytes], rng: np.random.Generator) -> bytearray:
    place, length = _place(data, rng), int(rng.integers(1, 200))
    data[place:place] = data[place : place + length] * int(rng.integers(1, 5))
    return data


def _splice(data: bytearray, seeds: list[bytes], rng: np.random.Generator) -> bytearray:
    other = seeds[int(rng.integers(len(seeds)))]
    start = int(rng.integers(len(other) + 1))
    place = _place(data, rng)
    data[place:place] = other[start : start + int(rng.integers(1, 400))]
    return data


def _word(data: bytearray, seeds: list[bytes], rng: np.random.Generator) -> bytearray:
    place = _place(data, rng)
    word = WORDS[int(rng.integers(len(WORDS)))]
    data[place : place + int(rng.integers(0, len(word) + 1))] = word
    return data


_DAMAGES = (_flip, _flip, _byte, _number, _number, _near, _cut, _remove, _repeat, _splice, _word, _word)
