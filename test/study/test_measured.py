"""What is measured: conditions, what is told, scenes, and the judgement of answers."""

import math
from collections import Counter
from dataclasses import dataclass
from itertools import islice

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from star_tracker.geometry.rotation import rotation_from_boresight
from star_tracker.geometry.spherical import unit_vectors
from star_tracker.maps.simulation import CAMERAS, CONDITIONS, Condition
from star_tracker.optics.camera import Camera
from star_tracker.study.chunks import IDENTIFIED, WRONG, FramesChunk, ImageChunk, compete
from star_tracker.study.contestants import Answer, Contestant, Entrant, Told
from star_tracker.study.own_methods import OwnMethod
from star_tracker.study.paper_forms import PaperForm
from star_tracker.study.quantities import condition_of
from star_tracker.study.scenes import Image, Scene, Sky, read_images, simulated

CAMERA = CAMERAS["12 deg"]
OWN = OwnMethod(method="match_group")


def solved(n=12, **values):
    condition = condition_of(values)
    limit_deg = condition.correct_deg(CAMERA)
    return FramesChunk(
        (OWN,), "12 deg", CAMERA, condition, 0, 0, n, 3, float("inf"), limit_deg
    ).solve()[0]


def test_half_a_pixel_is_right_and_its_angle_an_error():
    """The sky does not move in the detector's frame, but the tracker looks from another point."""
    found = solved(principal_point_offset_px=0.5)
    assert found.outcomes == [IDENTIFIED] * 12
    angle_deg = np.degrees(np.arctan(np.hypot(0.5, 0.5) / CAMERA.fx_px))
    np.testing.assert_allclose(found.error_deg, angle_deg, rtol=0.02)
    assert angle_deg == pytest.approx(0.0166, rel=0.01)


def test_an_offset_beyond_the_tolerance_is_wrong():
    found = solved(principal_point_offset_px=5)
    assert set(found.outcomes) <= {WRONG, "AMBIGUOUS", "NO_MATCH"}
    assert found.outcomes.count(WRONG) > 6


@pytest.mark.parametrize(
    ("parity", "right"), [("normal", 0), ("auto", 12), ("mirrored", 12)]
)
def test_a_mirrored_sky_is_solved_where_the_parity_is_known_or_asked_for(parity, right):
    found = solved(mirrored_sky_parity=parity, noise_px=0.5)
    assert found.outcomes.count(IDENTIFIED) == right
    assert WRONG not in found.outcomes


def test_a_wrong_field_of_view_is_told_with_its_tolerance_and_the_true_one_seen():
    condition = condition_of({"fov_error_percent": 2.0})
    assert condition.told_camera(CAMERA).fov_deg == pytest.approx(12.24)
    assert condition.true_camera(CAMERA) == CAMERA
    assert condition.fov_range_deg(CAMERA) == pytest.approx((12.24 * 0.976, 12.24 * 1.024))
    assert Condition("clean").fov_range_deg(CAMERA) == pytest.approx((12 * 0.99, 12 * 1.01))
    assert solved(fov_error_percent=1).outcomes == [IDENTIFIED] * 12


def test_a_field_of_view_that_is_not_told_may_be_any_and_only_the_fallback_declines():
    condition = condition_of({"fov_error_percent": "unknown"})
    assert condition.name == "view not told"
    assert condition.fov_range_deg(CAMERA) == (4, 70)
    assert condition.told_camera(CAMERA).fov_deg == pytest.approx(np.sqrt(4 * 70))
    assert OWN.declines(condition) == ""
    assert OwnMethod(method="radial_cyclic").declines(condition) == "it needs a field of view"
    assert PaperForm(method="match_group").declines(condition) == "it needs a field of view"


@pytest.mark.parametrize("told", [5, -5, 30, "unknown"])
def test_our_method_is_told_how_far_the_field_of_view_may_be_off_and_finds_it(told):
    condition = condition_of({"fov_error_percent": told, "noise_px": 0.5})
    entrant = OWN.set_up(Told.of(Sky(), CAMERA, condition, np.inf))
    for scene in simulated(Sky(), CAMERA, condition, 3, np.random.SeedSequence(8)):
        if scene.n_true < 6:
            continue
        answer = entrant.answer(entrant.solve(entrant.prepare(scene)))
        assert scene.error_deg(answer.rotation) < 0.1


def test_a_lens_that_is_not_told_bends_the_frames_only():
    """A true star at radius r is seen at r (1 + k1 r^2), so that the frame reaches farther."""
    condition = condition_of({"lens_k1": -0.3})
    assert condition.name == "k1 -0.3"
    assert condition.told_camera(CAMERA) == CAMERA
    bent = condition.true_camera(CAMERA)
    ray = [[np.tan(np.radians(5.0)), 0.0, 1.0]]
    x = bent.pixels(ray)[0, 0] - bent.cx_px
    r = np.tan(np.radians(5.0))
    assert x == pytest.approx(bent.fx_px * r * (1 - 0.3 * r**2))
    straight, seen = (
        next(simulated(Sky(), CAMERA, one, 1, np.random.SeedSequence(5)))
        for one in (Condition("clean"), condition)
    )
    centre = CAMERA.cx_px, CAMERA.cy_px
    out = np.linalg.norm(straight.xy_px - centre, axis=1)
    assert seen.n_true >= straight.n_true  # it sees farther
    assert np.all(np.sort(np.linalg.norm(seen.xy_px - centre, axis=1))[:len(out)] < np.sort(out))


def test_the_rule_of_what_is_correct():
    noisy = Condition("5 px", 5.0)
    assert Condition("1 px", 1.0).correct_deg(CAMERAS["20 deg"]) == 0.1
    assert noisy.correct_deg(CAMERA) == pytest.approx(np.degrees(4 * 5 / CAMERA.fx_px))
    assert noisy.correct_deg(CAMERA, noises=0) == 0.1
    assert [c.words for c in CONDITIONS][-1] == "sparse: 0.5 px, 60 % missing"


def test_brightness_is_measured_with_the_noise_asked_for():
    def scenes(**values):
        seed = np.random.SeedSequence(5)
        return simulated(Sky(), CAMERAS["20 deg"], condition_of(values), 40, seed)

    deviations = []
    for exact, noisy in zip(
        scenes(brightness_noise_mag=0), scenes(brightness_noise_mag=0.5), strict=True
    ):
        np.testing.assert_array_equal(exact.xy_px, noisy.xy_px)
        deviations += (-2.5 * np.log10(noisy.intensity / exact.intensity)).tolist()
    assert np.std(deviations) == pytest.approx(0.5, rel=0.05)
    assert next(scenes(noise_px=1)).intensity is None


# ---- answers ---------------------------------------------------------------------------------


def rotation(ra_deg, dec_deg=0.0, roll_deg=0.0):
    return rotation_from_boresight(*np.radians([ra_deg, dec_deg, roll_deg]))


@dataclass(frozen=True)
class Parrot(Contestant):
    """Says what it was told to say, frame after frame."""

    words: tuple = ()
    settings = "none"

    def set_up(self, told):
        words = [None, None, *self.words]  # two frames come before those that count
        return Entrant(
            lambda scene: scene.xy_px, lambda given: words.pop(0),
            lambda word: Answer(None if word is None else np.reshape(word, (3, 3))),
        )


def flat(matrix):
    return tuple(matrix.ravel().tolist())


TOLD = Told(Sky(), CAMERA, (11.9, 12.1), 0.0, 1.0)


@pytest.mark.parametrize(
    ("found", "outcome"),
    [
        (None, "NO_MATCH"),
        (rotation(10.0), IDENTIFIED),
        (rotation(10.099), IDENTIFIED),
        (rotation(10.101), WRONG),
        (rotation(190.0), WRONG),
        (rotation(10.0, roll_deg=30.0), IDENTIFIED),  # judged is the boresight
        (np.full((3, 3), np.nan), WRONG),
    ],
)
def test_a_solution_is_judged_by_its_boresight(found, outcome):
    scene = Scene(np.zeros((5, 2)), None, rotation(10.0)[:, 2], 5)
    parrot = Parrot(outcome, words=(None if found is None else flat(found),))
    result = compete((parrot,), TOLD, [(0, scene)], 0.1)[0]
    assert result.outcomes == [outcome]
    assert result.n_true == [5]
    assert len(result.cpu_ms) == len(result.error_deg) == 1


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_an_error_is_weighed_by_the_covariance_that_was_told(axis):
    """A turn of two standard deviations about an axis; that of the roll moves no boresight."""
    sigma_rad = np.array([1e-4, 3e-4, 5e-3])
    turn = Rotation.from_rotvec(2 * sigma_rad * np.eye(3)[axis])
    covariance = np.diag(sigma_rad**2)
    true = rotation(70.0, roll_deg=20.0)
    scene = Scene(np.zeros((5, 2)), None, (true @ turn.as_matrix())[:, 2], 5)
    assert scene.nees(true, covariance) == pytest.approx(0.0 if axis == 2 else 4.0, abs=1e-4)


def test_correlated_errors_are_weighed_with_their_sign():
    rng = np.random.default_rng(3)
    covariance = np.array([[4.0, 2.5, 0.0], [2.5, 3.0, 0.0], [0.0, 0.0, 90.0]]) * 1e-8
    true, found = rotation(70.0, roll_deg=20.0), []
    for turn in rng.multivariate_normal(np.zeros(3), covariance, 2000):
        claimed = true @ Rotation.from_rotvec(turn).as_matrix()
        found.append(Scene(np.zeros((5, 2)), None, true[:, 2]).nees(claimed, covariance))
    assert np.mean(found) == pytest.approx(2.0, abs=0.15)  # chi-square of 2 degrees of freedom


def test_each_frame_has_an_order_of_its_own_in_which_all_that_are_due_have_a_turn():
    """Each goes first, and follows each other one, as often as any other."""
    order, n = [], 600

    @dataclass(frozen=True)
    class Listener(Parrot):
        def set_up(self, told):
            entrant = super().set_up(told)
            return Entrant(
                lambda scene: order.append(self.name), lambda given: None, entrant.answer
            )

    scenes = [(number, Scene(np.zeros((0, 2)), None, np.zeros(3))) for number in range(n)]
    compete((Listener("a"), Listener("b"), Listener("c", every=2)), TOLD, scenes, 0.1)
    turns = iter("".join(order).removeprefix("aabbcc"))
    taken = ["".join(islice(turns, 2 if number % 2 else 3)) for number in range(n)]
    assert next(turns, None) is None
    assert all("".join(sorted(one)) == "abc" for one in taken[::2])
    assert all("".join(sorted(one)) == "ab" for one in taken[1::2])
    of_three = Counter(taken[::2])
    assert len(of_three) == 6
    sigma = math.sqrt(n / 2 * 1 / 6 * 5 / 6)
    assert all(abs(count - n / 2 / 6) < 4 * sigma for count in of_three.values())


# ---- real images -----------------------------------------------------------------------------

TRUTH = "file,width_px,height_px,ra_deg,dec_deg,fov_width_deg\na.png,512,512,84,-1,12\n"


def write_images(folder, rows, name="centroids.csv"):
    (folder / "truth.csv").write_text(TRUTH + "b.png,512,512,0,0,12\n", encoding="utf-8")
    (folder / name).write_text(rows, encoding="utf-8")


def test_real_images_are_read_with_their_camera(tmp_path):
    write_images(tmp_path, "file,x_px,y_px,intensity\na.png,1.5,2,30\na.png,3,4,20\n")
    (image,) = read_images(tmp_path)
    camera = Camera.from_fov(12, 512, 512)
    assert image == Image("a.png", camera, 84.0, -1.0, ((1.5, 2.0), (3.0, 4.0)), (30.0, 20.0))
    scene = image.scene()
    assert scene.intensity.tolist() == [30, 20]
    np.testing.assert_allclose(scene.boresight, unit_vectors(*np.radians([84, -1])))


@pytest.mark.parametrize(
    ("rows", "reason"),
    [
        ("file,x_px\na.png,1\n", "'y_px' in truth.csv or stars.csv"),
        ("file,x_px,y_px\na.png,1,?\n", "could not convert string to float: '\\?' in truth.csv"),
    ],
)
def test_centroids_that_are_none_are_told(tmp_path, rows, reason):
    write_images(tmp_path, rows, "stars.csv")
    with pytest.raises(ValueError, match=reason):
        read_images(tmp_path)


@pytest.mark.parametrize(
    ("folder", "reason"), [(None, "--images"), ("", "truth.csv: No such file or directory")]
)
def test_a_folder_without_images_is_told(tmp_path, folder, reason):
    with pytest.raises(ValueError, match=reason):
        read_images(None if folder is None else tmp_path)


def test_an_image_is_solved_with_a_sky_that_suits_it_and_the_camera_that_is_told():
    """Drawn from the Hipparcos stars to the depth that is taken for 12 deg."""
    sky = Sky.for_camera(CAMERA)
    catalog, pose = sky.catalog(), rotation(84.0, -1.0, 20.0)
    near = catalog.vectors @ pose[:, 2] > np.cos(np.radians(8))
    xy = CAMERA.pixels(catalog.vectors[near] @ pose)
    xy = xy[CAMERA.contains(xy)]
    image = Image("a.png", CAMERA, 84.0, -1.0, tuple(map(tuple, xy.tolist())))
    chunk = ImageChunk((OWN,), image, Condition("clean"), 1000.0, 0.1)
    assert chunk.place == ("real images", "clean")
    assert chunk.solve()[0].outcomes == [IDENTIFIED]
    heard = []

    class Listener(Parrot):
        def set_up(self, told):
            heard.append(told)
            return super().set_up(told)

    condition = condition_of({"fov_error_percent": -5.0})
    ImageChunk((Listener("l", words=(None,)),), image, condition, 1000.0, 0.1).solve()
    assert [told.camera.fov_deg for told in heard] == [pytest.approx(11.4)]
    assert heard[0].sky == Sky(7.0)  # for a field that may be as small as 10.7 deg
