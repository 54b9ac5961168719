# SPDX-License-Identifier: Apache-2.0
"""The CUDA stream that writes the caller's images."""

import contextvars

_current = contextvars.ContextVar("stream", default=0)


def handle_of(stream):
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

    def __init__(self, stream):
        self._stream = stream  # keeps it alive
        self.handle = handle_of(stream)
        self._before = []

    def __enter__(self):
        self._before.append(_current.set(self.handle))
        return self

    def __exit__(self, *_):
        _current.reset(self._before.pop())
