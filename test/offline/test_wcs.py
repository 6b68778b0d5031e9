"""FITS headers, read back by astropy."""

import warnings

import numpy as np
import pytest

from star_tracker.attitude.attitude import Attitude
from star_tracker.geometry.rotation import rotation_from_boresight
from star_tracker.geometry.spherical import ra_dec
from star_tracker.identification.labels import Identification
from star_tracker.offline.wcs import header_cards, header_text
from star_tracker.optics.camera import Camera
from star_tracker.optics.distortion import Distortion
from star_tracker.solution import Solution, Status


def solution(camera, ra_deg=83.0, dec_deg=-5.0, roll_deg=25.0):
    rotation = rotation_from_boresight(*np.radians([ra_deg, dec_deg, roll_deg]))
    return Solution(
        Status.SOLVED, "identified", Identification.empty(0),
        Attitude.from_rotation(rotation, np.eye(3)), told_camera=camera,
    ), rotation


CAMERAS = {
    "normal": Camera.from_fov(12, 512, 400, parity="normal"),
    "mirrored": Camera.from_fov(12, 512, 400, parity="mirrored"),
    "off axis": Camera(640, 480, 900.0, 905.0, 300.0, 250.0),
    "bent": Camera(1024, 768, 1100.0, 1100.0, 515.0, 380.0, "normal",
                   Distortion("plumb_bob", (-0.25, 0.08, 0.001, -0.0005, 0.0))),
    "bent, mirrored": Camera(1024, 768, 1100.0, 1100.0, 515.0, 380.0, "mirrored",
                             Distortion("plumb_bob", (-0.2, 0.05, 0.0, 0.0, 0.0))),
}


@pytest.mark.parametrize("name", CAMERAS)
@pytest.mark.parametrize("dec_deg", [-5.0, 89.5])
def test_astropy_finds_stars_where_the_camera_puts_them(name, dec_deg):
    """To 0.01 px, over the whole image; FITS counts the middle of the first pixel as 1."""
    wcs = pytest.importorskip("astropy.wcs", reason="needs astropy, an extra")
    fits = pytest.importorskip("astropy.io.fits")
    camera = CAMERAS[name]
    solved, rotation = solution(camera, dec_deg=dec_deg)
    header = fits.Header.fromstring(header_text(solved))
    with warnings.catch_warnings():
        # A header alone has no data, as other solvers' files have none: astropy says so.
        warnings.simplefilter("ignore", wcs.FITSFixedWarning)
        read = wcs.WCS(header)
    rng = np.random.default_rng(1)
    pixels = rng.random((200, 2)) * (camera.width_px, camera.height_px)
    ra, dec = np.degrees(ra_dec(camera.vectors(pixels) @ rotation.T))
    found = np.column_stack(read.all_world2pix(ra, dec, 1, tolerance=1e-5)) - 0.5
    np.testing.assert_allclose(found, pixels, atol=0.01)


def test_a_header_is_whole_blocks_of_cards():
    text = header_text(solution(CAMERAS["bent"])[0])
    assert len(text) % 2880 == 0
    assert text.startswith("SIMPLE  =                    T")
    assert text.rstrip().endswith("END")
    assert "CTYPE1  = 'RA---TAN-SIP'" in text


def test_a_camera_without_a_lens_has_no_polynomials():
    names = [card[0] for card in header_cards(solution(CAMERAS["normal"])[0])]
    assert "CD1_1" in names
    assert not [name for name in names if name.startswith(("A_", "B_", "AP_"))]


def test_an_unsolved_frame_has_no_header():
    unsolved = Solution(Status.NO_MATCH, "nothing", Identification.empty(0))
    with pytest.raises(ValueError, match="an unsolved frame has no header: NO_MATCH"):
        header_cards(unsolved)
