"""A solution as a FITS world coordinate system: TAN, or TAN-SIP where the lens bends.

Calabretta and Greisen (2002) for the tangent plane, Shupe et al. (2005) for SIP. FITS counts the
middle of the first pixel as 1, this package as 0.5.
"""

import numpy as np

from star_tracker.geometry.spherical import Floats, tangent_basis
from star_tracker.optics.camera import Camera
from star_tracker.solution import Solution

#: Order of the SIP polynomials, and points of the grid along each axis that they are fitted to.
_ORDER, _GRID = 7, 25
_FITS_OFFSET_PX = 0.5
_CARD = 80


def header_cards(solution: Solution) -> list[tuple[str, object, str]]:
    """Return the cards (keyword, value, comment) of a solved frame.

    Raises ValueError for an unsolved one.
    """
    camera, attitude = solution.camera, solution.attitude
    if camera is None or attitude is None:
        raise ValueError(f"an unsolved frame has no header: {solution.status.value}")
    bends = camera.distortion is not None
    kind = "-SIP" if bends else ""
    cd = _cd_matrix(camera, attitude.rotation)
    cards: list[tuple[str, object, str]] = [
        ("WCSAXES", 2, "number of axes"),
        ("CTYPE1", f"RA---TAN{kind}", "tangent plane"),
        ("CTYPE2", f"DEC--TAN{kind}", "tangent plane"),
        ("CUNIT1", "deg", ""), ("CUNIT2", "deg", ""),
        ("RADESYS", "ICRS", ""),
        ("CRVAL1", float(np.degrees(attitude.ra_rad)), "boresight, right ascension"),
        ("CRVAL2", float(np.degrees(attitude.dec_rad)), "boresight, declination"),
        ("CRPIX1", camera.cx_px + _FITS_OFFSET_PX, "principal point"),
        ("CRPIX2", camera.cy_px + _FITS_OFFSET_PX, "principal point"),
        ("CD1_1", float(cd[0, 0]), ""), ("CD1_2", float(cd[0, 1]), ""),
        ("CD2_1", float(cd[1, 0]), ""), ("CD2_2", float(cd[1, 1]), ""),
        ("IMAGEW", camera.width_px, "px"), ("IMAGEH", camera.height_px, "px"),
    ]
    return cards + (_sip_cards(camera) if bends else [])


def header_text(solution: Solution) -> str:
    """Return a FITS header of whole blocks. Raises ValueError for an unsolved frame."""
    cards = [
        ("SIMPLE", True, "conforms to FITS"), ("BITPIX", 8, ""), ("NAXIS", 0, "no data"),
        *header_cards(solution),
    ]
    text = "".join(_card(*card) for card in cards) + "END".ljust(_CARD)
    return text.ljust(-(-len(text) // 2880) * 2880)


def _cd_matrix(camera: Camera, rotation: Floats) -> Floats:
    """Return what turns pixels about the principal point into degrees east and north."""
    east, north = tangent_basis(rotation[:, 2])
    axes = np.array([[east @ rotation[:, 0], east @ rotation[:, 1]],
                     [north @ rotation[:, 0], north @ rotation[:, 1]]])
    y_sign = -1.0 if camera.parity == "mirrored" else 1.0
    return np.asarray(np.degrees(axes @ np.diag([1 / camera.fx_px, y_sign / camera.fy_px])))


def _sip_cards(camera: Camera) -> list[tuple[str, object, str]]:
    """Return the SIP polynomials: A and B to ideal pixels, AP and BP back."""
    x, y = np.meshgrid(
        np.linspace(0, camera.width_px, _GRID), np.linspace(0, camera.height_px, _GRID)
    )
    pixels = np.column_stack([x.ravel(), y.ravel()])
    pixels = pixels[camera.has_ray(pixels)] if hasattr(camera, "has_ray") else pixels
    plane = camera.plane(pixels)
    y_sign = -1.0 if camera.parity == "mirrored" else 1.0
    bent = pixels - (camera.cx_px, camera.cy_px)
    ideal = plane * (camera.fx_px, y_sign * camera.fy_px)
    cards: list[tuple[str, object, str]] = []
    for names, start, end in ((("A", "B"), bent, ideal), (("AP", "BP"), ideal, bent)):
        powers = [(i, j) for i in range(_ORDER + 1) for j in range(_ORDER + 1 - i)]
        scale = float(np.max(np.abs(start)))
        terms = np.column_stack([
            (start[:, 0] / scale) ** i * (start[:, 1] / scale) ** j for i, j in powers
        ])
        for axis, name in enumerate(names):
            values = np.linalg.lstsq(terms, (end - start)[:, axis], rcond=None)[0]
            cards.append((f"{name}_ORDER", _ORDER, ""))
            cards += [
                (f"{name}_{i}_{j}", float(value / scale ** (i + j)), "")
                for (i, j), value in zip(powers, values, strict=True)
            ]
    return cards


def _card(keyword: str, value: object, comment: str) -> str:
    if isinstance(value, bool):
        shown = ("T" if value else "F").rjust(20)
    elif isinstance(value, str):
        shown = f"'{value:<8}'".ljust(20)
    elif isinstance(value, float):
        shown = f"{value:.14E}".rjust(20)
    else:
        shown = str(value).rjust(20)
    return f"{keyword:<8}= {shown}{' / ' + comment if comment else ''}"[:_CARD].ljust(_CARD)
