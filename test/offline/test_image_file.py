"""Image files: all of their depth, or a sentence."""

import struct
import zlib

import numpy as np
import pytest

from star_tracker.offline.image_file import decode_image, read_image

Image = pytest.importorskip("PIL.Image", reason="Pillow is not installed")
RNG = np.random.default_rng(5)
GREY = RNG.integers(0, 4096, (6, 8), np.uint16)


def png(pixels):
    """A PNG of 16 bits, grey or colour: Pillow writes the former alone."""
    height, width = pixels.shape[:2]
    colour = {2: 0, 3: 2, 4: 6}[pixels.ndim if pixels.ndim == 2 else pixels.shape[2]]
    header = struct.pack(">IIBBBBB", width, height, 16, colour, 0, 0, 0)
    rows = b"".join(b"\0" + row.astype(">u2").tobytes() for row in pixels)
    parts = ((b"IHDR", header), (b"IDAT", zlib.compress(rows)), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))
        for name, data in parts
    )


def test_grey_of_16_bits_is_read_to_its_full_depth(tmp_path):
    path = tmp_path / "grey.png"
    path.write_bytes(png(GREY))
    np.testing.assert_array_equal(read_image(path), GREY)
    np.testing.assert_array_equal(decode_image(png(GREY)), GREY)


@pytest.mark.parametrize(("ending", "data"), [
    (".png", png(np.stack([GREY] * 3, axis=-1))),
    (".png", png(np.stack([GREY] * 4, axis=-1))),
    (".ppm", b"P6\n8 6\n65535\n" + np.stack([GREY] * 3, axis=-1).astype(">u2").tobytes()),
])
def test_colours_of_which_the_low_bits_would_be_lost_are_refused(ending, data, tmp_path):
    path = tmp_path / f"colour{ending}"
    path.write_bytes(data)
    with pytest.raises(ValueError, match="it is a colour image of 16 bits, of which Pillow keeps"):
        read_image(path)
    with pytest.raises(ValueError, match="save it as grey of 16 bits"):
        decode_image(data)


def test_colours_of_8_bits_are_read(tmp_path):
    pixels = RNG.integers(0, 256, (6, 8, 3), np.uint8)
    for ending in (".png", ".tif", ".ppm", ".bmp"):
        Image.fromarray(pixels).save(tmp_path / f"colour{ending}")
        np.testing.assert_array_equal(read_image(tmp_path / f"colour{ending}"), pixels)


def test_of_several_images_in_a_file_none_is_chosen_in_silence(tmp_path):
    path = tmp_path / "many.tif"
    pages = [Image.fromarray(GREY + np.uint16(k)) for k in range(3)]
    pages[0].save(path, save_all=True, append_images=pages[1:])
    with pytest.raises(ValueError, match="it holds 3 images: save each as a file of its own"):
        read_image(path)


def test_a_preview_beside_an_image_does_not_count(tmp_path):
    path = tmp_path / "preview.tif"
    preview = Image.fromarray(GREY[::2, ::2])
    preview.encoderinfo = {"tiffinfo": {254: 1}}
    Image.fromarray(GREY).save(path, save_all=True, append_images=[preview])
    np.testing.assert_array_equal(read_image(path), GREY)


def test_a_large_image_is_read_and_one_too_large_refused(tmp_path):
    """Beyond 89 million pixels Pillow warns, which is no error."""
    path = tmp_path / "large.png"
    Image.new("1", (10_000, 9_000)).save(path)
    assert read_image(path).shape[:2] == (9_000, 10_000)
    Image.new("1", (16_001, 10_000)).save(path)
    with pytest.raises(ValueError, match="it has 16001 x 10000 px, more than 160 million"):
        read_image(path)


def test_transparency_does_not_matter(tmp_path):
    path = tmp_path / "palette.png"
    image = Image.fromarray(RNG.integers(0, 256, (6, 8), np.uint8)).convert("P")
    image.save(path, transparency=bytes(range(256)))
    assert read_image(path).shape == (6, 8, 3)


def test_a_folder_is_no_file(tmp_path):
    with pytest.raises(ValueError, match="cannot be read: it is no file"):
        read_image(tmp_path)
