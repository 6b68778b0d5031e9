"""A solution -> markers on the unit sphere."""

from dataclasses import replace

import numpy as np
import pytest
from std_msgs.msg import Header
from visualization_msgs.msg import Marker

from star_tracker.attitude.attitude import Attitude
from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.geometry.spherical import separation
from star_tracker.identification.labels import Identification
from star_tracker.maps.star_map import paper_maps
from star_tracker.msg_adapters.markers import markers_from_solution
from star_tracker.optics.camera import Camera
from star_tracker.solution import Solution, SolveSettings, Status
from star_tracker.tracker import StarTracker

HEADER = Header(frame_id="icrs")
MAP = paper_maps((1,))[0]


@pytest.fixture(scope="module")
def markers(database):
    tracker = StarTracker(database, MAP.camera, SolveSettings(deadline_ms=60_000.0))
    solution = tracker.solve(MAP.xy_px)
    return markers_from_solution(solution, MAP.camera, database.catalog, HEADER).markers


def only(markers, namespace):
    return [marker for marker in markers if marker.ns == namespace]


def array(points):
    return np.array([[p.x, p.y, p.z] for p in points])


def test_what_was_drawn_before_is_removed_first(markers):
    assert markers[0].action == Marker.DELETEALL
    assert all(marker.action == Marker.ADD for marker in markers[1:])


def test_stars_are_points_on_the_unit_sphere_around_the_boresight(markers):
    (stars,) = only(markers, "stars")
    points = array(stars.points)
    assert (stars.type, stars.header.frame_id) == (Marker.POINTS, "icrs")
    assert len(points) == 15
    np.testing.assert_allclose(np.linalg.norm(points, axis=1), 1.0)
    boresight = MAP.pose.rotation[:, 2]
    assert np.degrees(max(separation(p, boresight) for p in points)) < 6 * np.sqrt(2)


def test_each_star_has_a_label_at_its_place(markers):
    labels = only(markers, "labels")
    assert len({label.id for label in labels}) == len(labels) == 15
    places = array([label.pose.position for label in labels])
    np.testing.assert_array_equal(places, array(only(markers, "stars")[0].points))
    assert all(label.text.split()[0] in ("HIP", "star") for label in labels)


def test_field_of_view_is_a_closed_line_around_the_stars(markers):
    (outline,) = only(markers, "field_of_view")
    points = array(outline.points)
    assert outline.type == Marker.LINE_STRIP
    np.testing.assert_allclose(points[0], points[-1])
    # Corner to opposite corner, of a square whose side is 12 deg across its middle.
    diagonal = 2 * np.degrees(np.arctan(np.sqrt(2) * np.tan(np.radians(6))))
    assert np.degrees(separation(points[0], points[16])) == pytest.approx(diagonal, abs=0.02)
    middle = points[[0, 8, 16, 24]].sum(axis=0)
    middle /= np.linalg.norm(middle)
    assert np.degrees(separation(middle, MAP.pose.rotation[:, 2])) < 0.02


def test_an_unsolved_frame_only_removes(catalog):
    solution = Solution(Status.NO_MATCH, "nothing", Identification.empty(5))
    (marker,) = markers_from_solution(solution, MAP.camera, catalog, HEADER).markers
    assert marker.action == Marker.DELETEALL


def test_each_star_is_called_what_the_catalogue_calls_it():
    sky = StarCatalog(
        np.eye(3), np.full(3, 4.0), np.array([32349, 0, 0]), np.array([1, 77, 0]),
        gaia_source=np.array([0, 0, 3328999114372334208]),
    )
    found = replace(
        Identification.empty(3), catalog_index=np.arange(3), state=np.full(3, 1, np.uint8)
    )
    solution = Solution(
        Status.SOLVED, "", found, Attitude.from_rotation(np.eye(3), np.eye(3)), parity="normal"
    )
    camera = Camera.from_fov(12, 512, 512)
    labels = only(markers_from_solution(solution, camera, sky, HEADER).markers, "labels")
    assert [label.text for label in labels] == [
        "HIP 32349", "star 77", "Gaia DR3 3328999114372334208"
    ]
