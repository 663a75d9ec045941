"""Progress of long calls: tqdm where it is installed, else a line a stage on stderr."""

from __future__ import annotations

import importlib
import sys
from typing import Any, Callable, Optional, Protocol, Union

#: ``True`` for bars, or a function that is called with the stage, the items done and their number (0 where
#: it is not known).
Progress = Union[bool, Callable[[str, int, int], object]]


class Reporter(Protocol):
    """What the native part tells progress to."""

    def begin(self, stage: str, total: int) -> None: ...

    def advance(self, items: int) -> None: ...

    def end(self) -> None: ...


class _Calls:
    """Progress for a function of the user's."""

    def __init__(self, function: Callable[[str, int, int], object]) -> None:
        self._function = function
        self._stage, self._done, self._total = "", 0, 0

    def begin(self, stage: str, total: int) -> None:
        self._stage, self._done, self._total = stage, 0, total
        self._function(stage, 0, total)

    def advance(self, items: int) -> None:
        self._done += items
        self._function(self._stage, self._done, self._total)

    def end(self) -> None:
        pass


class _Bars:
    """One bar of tqdm a stage."""

    def __init__(self, tqdm: Any) -> None:
        self._tqdm = tqdm
        self._bar: Any = None

    def begin(self, stage: str, total: int) -> None:
        self.end()
        self._bar = self._tqdm(total=total or None, desc=stage, leave=False)

    def advance(self, items: int) -> None:
        if self._bar is not None:
            self._bar.update(items)

    def end(self) -> None:
        if self._bar is not None:
            self._bar.close()
            self._bar = None


class _Lines:
    """The name of every stage as it begins."""

    def begin(self, stage: str, total: int) -> None:
        print(f"{stage} ({total})" if total else stage, file=sys.stderr, flush=True)

    def advance(self, items: int) -> None:
        pass

    def end(self) -> None:
        pass


def reporter(progress: Progress) -> Optional[Reporter]:
    """What to tell progress to; ``None`` where nobody asked."""
    if progress is False or progress is None:
        return None
    if callable(progress):
        return _Calls(progress)
    try:
        return _Bars(importlib.import_module("tqdm.auto").tqdm)
    except ImportError:
        return _Lines()
