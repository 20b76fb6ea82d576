"""Seeded damage to the bytes of a file."""

import struct

import numpy as np

INTERESTING = (0, 1, 2, 0x7F, 0x80, 0xFF, 0x7FFF, 0x8000, 0xFFFF, 0x7FFFFFFF, 0x80000000, 2**32 - 1)
WORDS = (
    "nan inf -inf 1e999 -1 0 99999999999999999999 null true [] {} [[ {{ }} ]] , ; : ' \" \\ \n \0"
    " $(id) `id` ../../etc/passwd /etc/passwd -rf %s ${HOME} é & * ! !!python/name:os.system &a *a"
)
TOKENS = (
    *(word.encode() for word in WORDS.split(" ")),
    *(b"\xff\xfe", b"\xef\xbb\xbf", b"\r", b"\x1f\x8b", b" " * 40, b"a" * 5000),
)


def mutated(content: bytes, rng: np.random.Generator) -> bytes:
    """One to eight random edits."""
    data = bytearray(content)
    for _ in range(1 + int(rng.integers(8)) * int(rng.integers(2))):
        EDITS[rng.integers(len(EDITS))](data, rng)
    return bytes(data)


def _at(data, rng):
    """A place; half of the time near the start, where headers are."""
    reach = min(len(data), 400) if rng.integers(2) else len(data)
    return int(rng.integers(reach + 1))


def flip_bit(data, rng):
    if data:
        at = min(_at(data, rng), len(data) - 1)
        data[at] ^= 1 << int(rng.integers(8))


def set_byte(data, rng):
    if data:
        data[min(_at(data, rng), len(data) - 1)] = int(rng.integers(256))


def set_integer(data, rng):
    """Overwrite 2, 4 or 8 bytes with a number that breaks sums."""
    code = ("<H", ">H", "<I", ">I", "<Q", ">Q")[rng.integers(6)]
    size = struct.calcsize(code)
    value = INTERESTING[rng.integers(len(INTERESTING))] - int(rng.integers(2))
    at = _at(data, rng)
    data[at : at + size] = struct.pack(code, value % 256**size)[: max(len(data) - at, 0)]


def cut(data, rng):
    del data[_at(data, rng) :]


def remove(data, rng):
    at = _at(data, rng)
    del data[at : at + int(rng.integers(1, 64))]


def repeat(data, rng):
    at = _at(data, rng)
    part = data[at : at + int(rng.integers(1, 200))]
    data[at:at] = part * int(rng.integers(1, 6))


def insert_token(data, rng):
    at = _at(data, rng)
    token = TOKENS[rng.integers(len(TOKENS))]
    data[at : at + len(token) * int(rng.integers(2))] = token


def swap(data, rng):
    one, other = sorted((_at(data, rng), _at(data, rng)))
    data[one:] = data[other:] + data[one:other]


EDITS = (flip_bit, set_byte, set_integer, cut, remove, repeat, insert_token, swap)
EDITS = (*EDITS, flip_bit, set_byte, set_integer, insert_token)
