"""Threads for the kernel, which runs outside the interpreter's lock."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import Protocol, TypeVar

T = TypeVar("T")
R = TypeVar("R")


class Each(Protocol):
    """``map`` over one iterable."""

    def __call__(self, work: Callable[[T], R], items: Iterable[T], /) -> Iterable[R]:
        """The results of ``work``, in order."""


@contextmanager
def threads(jobs: int) -> Iterator[Each]:
    """A ``map`` that works on so many threads; with one, in the caller's own, at no cost."""
    if jobs <= 1:
        yield map
        return
    with ThreadPoolExecutor(jobs) as pool:
        yield pool.map
