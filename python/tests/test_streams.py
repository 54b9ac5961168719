# SPDX-License-Identifier: Apache-2.0
"""Whose stream calls wait for."""

import threading

import numpy as np
import pytest
from conftest import HEIGHT, WIDTH, Walk

import ft
from ft.streams import handle_of


class OfTorch:
    cuda_stream = 11


class OfCupy:
    ptr = 12


class OfAny:
    def __cuda_stream__(self):
        return 0, 13


def test_the_innermost_stream_is_that_of_a_call():
    assert handle_of(None) == 0
    with ft.Stream(OfTorch()) as outer:
        assert handle_of(None) == outer.handle == 11
        with ft.Stream(OfCupy()):
            assert handle_of(None) == 12
            assert handle_of(7) == 7
        with pytest.raises(KeyError), ft.Stream(OfAny()):
            assert handle_of(None) == 13
            raise KeyError
        with outer:
            assert handle_of(None) == 11
        assert handle_of(None) == 11
    assert handle_of(None) == 0


def test_a_stream_is_that_of_one_thread():
    seen = []
    with ft.Stream(5):
        other = threading.Thread(target=lambda: seen.append(handle_of(None)))
        other.start()
        other.join()
    assert seen == [0]


@pytest.mark.parametrize("wrong", ["a", -1, 1.5, object()])
def test_what_is_no_stream_is_refused(wrong):
    with pytest.raises(ValueError, match="stream is"):
        ft.Stream(wrong)
    with pytest.raises(ValueError, match="stream is"):
        ft.OrbExtractor(WIDTH, HEIGHT, device="host").extract(np.zeros((HEIGHT, WIDTH), np.uint8), stream=wrong)


def test_images_on_the_host_are_written_by_no_stream():
    image = Walk().frame(0)[0]
    extractor = ft.OrbExtractor(WIDTH, HEIGHT, device="host")
    alone = extractor.extract(image)
    with ft.Stream(OfAny()):
        within = extractor.extract(image)
    assert len(alone.x) > 100
    assert np.array_equal(alone.x, within.x) and np.array_equal(alone.descriptors, within.descriptors)


def test_images_of_cupy_are_awaited():
    cupy = pytest.importorskip("cupy")
    if len(ft.devices()) < 2:
        pytest.skip("no GPU")
    extractor = ft.OrbExtractor(WIDTH, HEIGHT, device="cuda")
    image = Walk().frame(0)[0]
    expected = extractor.extract(image)
    stream = cupy.cuda.Stream(non_blocking=True)
    with stream, ft.Stream(stream):
        found = extractor.extract(cupy.asarray(image))
    assert np.array_equal(found.x, expected.x) and np.array_equal(found.descriptors, expected.descriptors)
