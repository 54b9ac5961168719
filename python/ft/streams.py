# SPDX-License-Identifier: Apache-2.0
"""The CUDA stream that writes the caller's images."""

from __future__ import annotations

import contextvars
from typing import Protocol, Union

_current: contextvars.ContextVar[int] = contextvars.ContextVar("stream", default=0)


class Array(Protocol):
    """An array of NumPy, or one on a GPU, such as those of CuPy and PyTorch."""

    def __dlpack__(self) -> object: ...


class _HasPointer(Protocol):
    """A stream of CuPy."""

    ptr: int


class _HasStream(Protocol):
    """A stream of PyTorch."""

    @property
    def cuda_stream(self) -> int: ...


class _HasProtocol(Protocol):
    """A stream of anything else."""

    def __cuda_stream__(self) -> tuple[int, int]: ...


StreamLike = Union[int, _HasPointer, _HasStream, _HasProtocol]


def handle_of(stream: object) -> int:
    """The handle of a stream, an int: None is that of the innermost `with ft.Stream(...)`, else the default stream."""
    if stream is None:
        return _current.get()
    if hasattr(stream, "__cuda_stream__"):
        stream = stream.__cuda_stream__()[1]
    elif hasattr(stream, "cuda_stream"):
        stream = stream.cuda_stream
    elif hasattr(stream, "ptr"):
        stream = stream.ptr
    if not isinstance(stream, int) or stream < 0:
        raise ValueError(f"stream is {stream!r}, must be a handle, 0 or more, or a stream of CuPy or PyTorch")
    return int(stream)


class Stream:
    """`with ft.Stream(s):` calls inside wait for the images that the CUDA stream s writes, as with stream=s. s: a handle, 0 =
    the default stream, or a stream of CuPy or PyTorch, which must live as long. Holds for the calling thread. Raises
    ValueError for anything else."""

    def __init__(self, stream: StreamLike) -> None:
        self._stream = stream  # keeps it alive
        self.handle = handle_of(stream)
        self._before: list[contextvars.Token[int]] = []

    def __enter__(self) -> Stream:
        self._before.append(_current.set(self.handle))
        return self

    def __exit__(self, *_: object) -> None:
        _current.reset(self._before.pop())
