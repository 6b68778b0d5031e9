"""`star_tracker render`: the image that a camera would take of the sky, with its truth."""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

from star_tracker.calibration.camera_file import read_camera
from star_tracker.catalogue.catalog import CATALOGS, StarCatalog
from star_tracker.commands.options import (
    Record,
    add_json_argument,
    add_values,
    check_positive,
    json_text,
)
from star_tracker.detection.image import BAYER_PATTERNS
from star_tracker.detection.render import render
from star_tracker.detection.render_settings import Planet, RenderedImage, RenderSettings
from star_tracker.maps.star_map import Pose
from star_tracker.offline.image_writing import check_image_name, write_image
from star_tracker.optics.camera import Camera

_DEFAULT = RenderSettings()
#: The numbers of `RenderSettings` by group: field, metavar, what the help says.
_NUMBERS = {
    "exposure and lens": (
        ("exposure_s", "S", "time of exposure, s"),
        ("zero_point_mag", "MAG", "magnitude V of a star of one electron a second, mag"),
        ("psf_sigma_px", "PX", "width of a star, the standard deviation of a Gaussian, px"),
    ),
    "sky": (
        ("sky_e_per_s", "E", "background of a pixel, electrons/s"),
        ("clouds_mag", "MAG", "extinction where clouds are thickest, mag; 0 = no clouds"),
        ("clouds_scale_px", "PX", "size of a cloud, px"),
    ),
    "sensor": (
        ("read_noise_e", "E", "noise of a read-out, electrons"),
        ("row_banding_e", "E", "noise of the rows' offsets, electrons"),
        ("column_banding_e", "E", "noise of the columns' offsets, electrons"),
        ("hot_pixels", "PART", "part of the pixels that are hot"),
        ("hot_pixel_e", "E", "their mean charge, electrons"),
        ("full_well_e", "E", "largest charge of a pixel, electrons"),
        ("gain_e_per_dn", "E", "electrons for each unit of the image"),
        ("bias_dn", "DN", "level of no charge, units of the image"),
        ("bits", "N", "bits of the converter, 8 to 16; 8 give an image of 8 bits, more one of 16"),
        ("seed", "N", "of all chance; each further file has one more"),
    ),
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the files, the camera, where it points, and all that makes the image."""
    parser.add_argument(
        "files", nargs="+", type=Path, metavar="FILE",
        help="where an image goes, as .png, .tif, .bmp, .fits or .npy; each has its own noise",
    )
    add_json_argument(parser)
    _add_camera_arguments(parser.add_argument_group("camera"))
    _add_sky_arguments(parser.add_argument_group("attitude and stars"))
    for title, numbers in _NUMBERS.items():
        group = parser.add_argument_group(title)
        add_values(group, *(
            (_option(name), getattr(_DEFAULT, name), metavar, text)
            for name, metavar, text in numbers
        ))
        if title.startswith("exposure"):
            group.add_argument(
                "--rate-deg-s", metavar="X,Y,Z",
                help="rate of turn about the camera's axes, deg/s (0,0,0)",
            )
        elif title == "sky":
            group.add_argument(
                "--sky-gradient", metavar="X,Y",
                help="change of the background across width and height, as a part (0,0)",
            )
        else:
            group.add_argument(
                "--bayer", choices=BAYER_PATTERNS, help="colours of a raw image's pixels (none)"
            )
            group.add_argument(
                "--bleeding", action="store_true", help="let charge run along saturated columns"
            )


def _add_camera_arguments(camera: argparse._ArgumentGroup) -> None:
    camera.add_argument(
        "--camera", type=Path, metavar="FILE",
        help="camera calibration of ROS, YAML, with its lens (as the next options say)",
    )
    add_values(
        camera,
        ("--fov-deg", 20.0, "DEG", "field of view across the width, deg"),
        ("--width-px", 640, "PX", "width of the image, px"),
        ("--height-px", 480, "PX", "its height, px"),
    )
    camera.add_argument(
        "--parity", choices=("normal", "mirrored"), default="normal",
        help="of the image (%(default)s)",
    )


def _add_sky_arguments(sky: argparse._ArgumentGroup) -> None:
    add_values(
        sky,
        ("--ra-deg", 0.0, "DEG", "right ascension of the boresight, deg"),
        ("--dec-deg", 0.0, "DEG", "its declination, deg"),
        ("--roll-deg", 0.0, "DEG", "position angle of the image's up direction, deg"),
        ("--limiting-magnitude", 8.0, "MAG", "faintest stars, mag"),
        ("--epoch", 2000.0, "YEAR", "epoch of the stars' places, Julian year"),
    )
    sky.add_argument(
        "--catalog", choices=CATALOGS, default="hipparcos", help="of the stars (%(default)s)"
    )
    sky.add_argument(
        "--planet", action="append", metavar="RA,DEC,V",
        help="a light that no catalogue has, deg and mag; may be given again (none)",
    )


def execute(options: argparse.Namespace) -> None:
    """Render the images. Raises ValueError for what cannot be used."""
    for path in options.files:
        check_image_name(path)
    check_positive(options, "fov_deg", "width_px", "height_px")
    camera, pose, settings = _camera(options), _pose(options), _settings(options)
    catalog = StarCatalog.named(
        options.catalog, limiting_magnitude=options.limiting_magnitude, epoch=options.epoch
    )
    for i, path in enumerate(options.files):
        seeded = replace(settings, seed=settings.seed + i)
        made = render(camera, pose.rotation, catalog, seeded)
        write_image(path, made.image)
        stars = _stars(made, camera, catalog)
        if options.json:
            print(json_text({
                "file": str(path), "seed": seeded.seed, "ra_deg": pose.ra_deg,
                "dec_deg": pose.dec_deg, "roll_deg": pose.roll_deg, "fov_deg": camera.fov_deg,
                "width_px": camera.width_px, "height_px": camera.height_px,
                "parity": camera.parity, "saturation": seeded.saturation_dn, "stars": stars,
            }))
        else:
            print(
                f"{path}: {camera.width_px} x {camera.height_px} px, RA {pose.ra_deg:g} Dec "
                f"{pose.dec_deg:+g} roll {pose.roll_deg:g} deg, field {camera.fov_deg:.4g} deg "
                f"{camera.parity}, {len(stars)} stars to {options.limiting_magnitude:g} mag"
            )


def _camera(options: argparse.Namespace) -> Camera:
    """Return the camera, of definite parity. Raises ValueError."""
    if options.camera is not None:
        return read_camera(options.camera).with_parity(options.parity)
    return Camera.from_fov(
        options.fov_deg, options.width_px, options.height_px, parity=options.parity
    )


def _pose(options: argparse.Namespace) -> Pose:
    pose = Pose(options.ra_deg, options.dec_deg, options.roll_deg)
    if not np.all(np.isfinite([pose.ra_deg, pose.dec_deg, pose.roll_deg])):
        raise ValueError("--ra-deg, --dec-deg and --roll-deg must be finite numbers")
    if abs(pose.dec_deg) > 90:
        raise ValueError(f"--dec-deg {pose.dec_deg:g} is none: give -90 to 90")
    return pose


def _settings(options: argparse.Namespace) -> RenderSettings:
    """Return what the options say of the image. Raises ValueError naming a value out of range."""
    values = {
        name: getattr(options, name) for numbers in _NUMBERS.values() for name, *_ in numbers
    }
    if values["seed"] < 0:
        raise ValueError("--seed must be 0 or more")
    gradient_x, gradient_y = _list(options, "sky_gradient", 2)
    x, y, z = _list(options, "rate_deg_s", 3)
    return RenderSettings(
        **values, sky_gradient=(gradient_x, gradient_y), rate_deg_s=(x, y, z),
        bleeding=options.bleeding, bayer=options.bayer or "",
        planets=tuple(
            Planet(*_numbers("--planet", text, 3)) for text in options.planet or ()
        ),
    )


def _list(options: argparse.Namespace, name: str, length: int) -> list[float]:
    text = getattr(options, name)
    return [0.0] * length if text is None else _numbers(_option(name), text, length)


def _numbers(option: str, text: str, length: int) -> list[float]:
    try:
        numbers = [float(word) for word in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != length or not np.all(np.isfinite(numbers)):
        raise ValueError(f"{option} {text!r} must be {length} numbers with commas between them")
    return numbers


def _stars(made: RenderedImage, camera: Camera, catalog: StarCatalog) -> list[Record]:
    """Return the truth of each light that stands in the image, the brightest first."""
    inside = np.flatnonzero(camera.contains(made.xy_px, 0.0))
    rows: list[Record] = []
    for i in inside[np.argsort(-made.electrons[inside], kind="stable")].tolist():
        star = int(made.catalog_index[i])
        x, y = made.xy_px[i].tolist()
        rows.append({
            "x_px": x, "y_px": y, "hip": int(catalog.hip[star]) if star >= 0 else None,
            "v_mag": float(catalog.v_mag[star]) if star >= 0 else None,
            "electrons": float(made.electrons[i]),
        })
    return rows


def _option(name: str) -> str:
    return "--" + name.replace("_", "-")
