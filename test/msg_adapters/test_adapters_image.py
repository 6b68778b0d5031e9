"""Image and CompressedImage: each encoding there and back, and a sentence for what is not read."""

import array
import sys

import numpy as np
import pytest
from ros_helpers import new_header
from sensor_msgs.msg import CompressedImage, Image

from star_tracker.msg_adapters.image import (
    ENCODINGS,
    ImageError,
    Picture,
    compressed_from_picture,
    image_from_picture,
    picture_from_compressed,
    picture_from_image,
)
from star_tracker.offline import image_file

RNG = np.random.default_rng(5)
#: Values of a pixel by the encoding's first word.
VALUES = {"rgb": 3, "bgr": 3, "rgba": 4, "bgra": 4, "8UC3": 3}


def picture_of(encoding, shape=(3, 5)):
    """A picture of noise that an encoding can hold."""
    word = encoding.rstrip("0123456789") if encoding[0].isalpha() else encoding
    shape = (*shape, VALUES[word]) if word in VALUES else shape
    if encoding == "32FC1":
        return Picture(RNG.normal(size=shape).astype(np.float32))
    kind = np.uint16 if "16" in encoding else np.uint8
    bayer = encoding.split("_")[1][:4] if encoding.startswith("bayer") else ""
    return Picture(RNG.integers(0, np.iinfo(kind).max, shape, kind, endpoint=True), bayer)


def mono8(**fields):
    """A message of 4 x 3 px, with other fields than those that fit."""
    return Image(**{
        "header": new_header(), "width": 4, "height": 3, "encoding": "mono8", "step": 4,
        "data": array.array("B", bytes(range(12))), **fields,
    })


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_each_encoding_there_and_back(encoding):
    picture, header = picture_of(encoding), new_header("eye")
    message = image_from_picture(picture, encoding, header)
    assert (message.header, message.encoding) == (header, encoding)
    assert message.step * message.height == len(message.data)
    read = picture_from_image(message)
    np.testing.assert_array_equal(read.pixels, picture.pixels)
    assert read.pixels.dtype == picture.pixels.dtype
    assert read.bayer == picture.bayer


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_the_other_byte_order_is_read(encoding):
    picture = picture_of(encoding)
    message = image_from_picture(picture, encoding, new_header())
    swapped = np.frombuffer(message.data, picture.pixels.dtype).byteswap()
    message.data = array.array("B", swapped.tobytes())
    message.is_bigendian = int(sys.byteorder == "little")
    np.testing.assert_array_equal(picture_from_image(message).pixels, picture.pixels)


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("last_is_whole", [True, False])
def test_padded_rows_are_read(encoding, last_is_whole):
    picture = picture_of(encoding)
    message = image_from_picture(picture, encoding, new_header())
    step, height = message.step, message.height
    rows = np.frombuffer(message.data, np.uint8).reshape(height, step)
    data = np.pad(rows, ((0, 0), (0, 7)), constant_values=99).tobytes()
    message.data = array.array("B", data if last_is_whole else data[:-7])
    message.step = step + 7
    np.testing.assert_array_equal(picture_from_image(message).pixels, picture.pixels)


def test_blue_comes_last_whatever_the_message_begins_with():
    pixels = np.array([[[1, 2, 3]]], np.uint8)
    message = image_from_picture(Picture(pixels), "bgr8", new_header())
    assert list(message.data) == [3, 2, 1]
    pixels = np.array([[[1, 2, 3, 4]]], np.uint8)
    message = image_from_picture(Picture(pixels), "bgra8", new_header())
    assert list(message.data) == [3, 2, 1, 4]


@pytest.mark.parametrize(("fields", "kind", "text"), [
    (
        {"encoding": "yuv422"}, "encoding",
        "Image encoding yuv422 is not known: convert it to mono8, mono16, 32FC1, rgb8, bgr8 or a "
        "bayer pattern",
    ),
    (
        {"encoding": ""}, "encoding",
        "Image encoding '' is not known: convert it to mono8, mono16, 32FC1, rgb8, bgr8 or a "
        "bayer pattern",
    ),
    (
        {"width": 0}, "empty",
        "Image is 0 x 3 px and holds no pixel: check the camera's driver",
    ),
    (
        {"height": 0}, "empty",
        "Image is 4 x 0 px and holds no pixel: check the camera's driver",
    ),
    (
        {"width": 20_000, "height": 20_000}, "too_large",
        "Image is 20000 x 20000 px, more than 160 million pixels: bin or crop it",
    ),
    (
        {"step": 3}, "step",
        "Image step 3 is less than width 4 x 1 bytes of a mono8 pixel: make them agree",
    ),
    (
        {"encoding": "rgb16"}, "step",
        "Image step 4 is less than width 4 x 6 bytes of a rgb16 pixel: make them agree",
    ),
    (
        {"height": 4}, "data",
        "Image data has 12 bytes, but height 4 x step 4 is 16: make them agree",
    ),
    (
        {"step": 2**32 - 1}, "data",
        "Image data has 12 bytes, but height 3 x step 4294967295 is 12884901885: make them agree",
    ),
])
def test_what_cannot_be_read_is_said_in_one_sentence(fields, kind, text):
    with pytest.raises(ImageError) as caught:
        picture_from_image(mono8(**fields))
    assert (caught.value.kind, str(caught.value)) == (kind, text)


@pytest.mark.parametrize(("picture", "encoding", "text"), [
    (Picture(np.zeros((2, 2), np.uint8)), "yuv422", "encoding 'yuv422' is unknown: use mono8, "),
    (
        Picture(np.zeros((2, 2), np.uint8)), "mono16",
        "an image of uint8 and shape (2, 2) is not mono16: convert it",
    ),
    (
        Picture(np.zeros((2, 2, 3), np.uint8)), "mono8",
        "an image of uint8 and shape (2, 2, 3) is not mono8: convert it",
    ),
    (
        Picture(np.zeros((2, 2), np.uint8)), "bayer_rggb8",
        "encoding bayer_rggb8 is not of a pattern 'none'",
    ),
])
def test_what_does_not_fit_an_encoding_is_not_written(picture, encoding, text):
    with pytest.raises(ValueError) as caught:  # noqa: PT011
        image_from_picture(picture, encoding, new_header())
    assert str(caught.value).startswith(text)


@pytest.mark.parametrize("encoding", ["mono8", "mono16", "rgb8", "bayer_grbg8", "bayer_bggr16"])
def test_compressed_there_and_back(encoding):
    pytest.importorskip("PIL", reason="Pillow is not installed")
    picture, header = picture_of(encoding), new_header("eye")
    message = compressed_from_picture(picture, header)
    assert message.header == header
    read = picture_from_compressed(message)
    np.testing.assert_array_equal(read.pixels, picture.pixels)
    assert read.bayer == picture.bayer


def test_colours_that_were_made_of_a_pattern_have_none():
    pytest.importorskip("PIL", reason="Pillow is not installed")
    message = compressed_from_picture(picture_of("rgb8"), new_header())
    message.format = "bayer_rggb8; jpeg compressed bgr8"
    assert picture_from_compressed(message).bayer == ""


def test_data_that_is_no_picture_is_refused_in_one_sentence():
    pytest.importorskip("PIL", reason="Pillow is not installed")
    message = CompressedImage(format="jpeg", data=array.array("B", b"not a picture"))
    with pytest.raises(ImageError) as caught:
        picture_from_compressed(message)
    assert (caught.value.kind, str(caught.value)) == ("compressed", (
        "CompressedImage of format jpeg cannot be decoded (it is no image): send JPEG or PNG, of "
        "8 bits or grey of 16"
    ))


def test_a_picture_too_large_is_not_even_decoded(monkeypatch):
    pytest.importorskip("PIL", reason="Pillow is not installed")
    monkeypatch.setattr(image_file, "MAX_PIXELS", 14)
    with pytest.raises(ImageError) as caught:
        picture_from_compressed(compressed_from_picture(picture_of("mono8"), new_header()))
    assert str(caught.value) == (
        "CompressedImage of format mono8; png compressed mono8 cannot be decoded (it has 5 x 3 "
        "px, more than 0 million: bin or crop it): send JPEG or PNG, of 8 bits or grey of 16"
    )


def test_a_cut_file_is_refused():
    pytest.importorskip("PIL", reason="Pillow is not installed")
    message = compressed_from_picture(picture_of("mono8", (40, 50)), new_header())
    message.data = message.data[:200]
    with pytest.raises(ImageError) as caught:
        picture_from_compressed(message)
    assert "\n" not in str(caught.value)


def test_a_missing_pillow_is_named_with_its_remedy(monkeypatch):
    message = CompressedImage(format="png", data=array.array("B", b"any"))
    monkeypatch.setitem(sys.modules, "PIL", None)
    with pytest.raises(ImageError) as caught:
        picture_from_compressed(message)
    assert (caught.value.kind, str(caught.value)) == ("pillow", (
        "CompressedImage needs Pillow: apt install python3-pil, or pip install Pillow"
    ))
