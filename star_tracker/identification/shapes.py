"""The search by shape: triangles vote for a guide star and a roll, at any scale or at a known one.

A main star and two of its companions make a triangle. The ratio of its sides and the angle between
them are the same at any focal length, so that the guide-star triangles of that shape
(`catalogue.triangles`) vote for a guide star and a roll as pairs of a known separation do. The
members of a winning cell then each tell a scale, observed over catalogue separation; those that
agree in scale and roll make the candidate. Where the scale is known only the triangles of its size
vote: those of four companions are a twentieth of the pairs that would, and hardly any by chance.
"""

from typing import Any

import numpy as np

from star_tracker.catalogue.pairs import AZIMUTH_UNITS
from star_tracker.catalogue.triangles import (
    MAIN_BITS,
    ORDER_BITS,
    RATIO_LOW,
    RATIO_RANGE,
    SIZE_LOW,
    SIZE_RANGE,
    TriangleTable,
)
from star_tracker.compiled import compiled, first_not_below, inlined, prefetch, struct
from star_tracker.identification.cells import MEMBERS
from star_tracker.identification.progress import late
from star_tracker.identification.votes import (
    ANY_ORDER,
    ROLL_BINS,
    ROLL_BITS,
    Reading,
    angle_in_image,
    count_waiting,
    nearest,
    vote_rows,
)

#: So many runs of rows vote of a batch of companions, and so many cells that may hold them are
#: looked at.
_MOST_RUNS, _MOST_CELLS = 8192, 32_768
#: So many runs vote, one more being a power of two, between two looks at the clock: some 0.1 ms.
_LOOK_AT_CLOCK = 127
#: A star this many times as bright as another one is the brighter one: half a magnitude, which the
#: noise and the colours of two true stars rarely make up for. Nearer ones may stand in any order.
_SURELY_BRIGHTER = 10**0.2
#: Orders of brightness of a triangle (`triangles.ORDER_BITS`) in which one of its stars is the
#: brighter one, and the fainter one: main and first companion, main and second, first and second.
_BRIGHTER, _FAINTER = (
    tuple(
        sum(1 << order for order in range(1 << ORDER_BITS) if (order >> bit & 1) == wanted)
        for bit in range(ORDER_BITS)
    )
    for wanted in (1, 0)
)
#: A separation or a shape that is less certain than this, relative, does not vote.
_VAGUEST = 0.2

#: What `TriangleTable` holds, for compiled code.
TrianglesType, Triangles = struct("Triangles", __name__, TriangleTable._fields)

#: Room for a main star's search by shape:
#:
#: - star, separation, log_separation, azimuth: (c,) its companions in the frame, their separation
#:   and its log, rad, and their position angle, rad;
#: - intensity, own_intensity: (c,) theirs and the main star's, 0 = not known or not asked for;
#: - first, last, units, orders: (r,) runs of triangle rows that vote (of cells, until all are
#:   chosen), the azimuth to take from theirs, and of which orders of brightness (`votes.Reading`);
#: - n_runs: how many;
#: - companion, guide, log_ratio, roll, slack: (m,) members of a cell: places among the companions
#:   and in the guide star's fan, log of observed over catalogue separation, roll from the middle
#:   of the cell, and the tolerance of both.
FanType, Fan = struct("Fan", __name__, (
    "star", "separation", "log_separation", "azimuth", "intensity", "own_intensity", "first",
    "last", "units", "orders", "n_runs", "companion", "guide", "log_ratio", "roll", "slack",
))


@compiled
def empty_fan(most: int) -> Any:
    """Return room for so many companions."""
    return Fan(
        np.empty(most, np.int64), np.empty(most), np.empty(most), np.empty(most),
        np.empty(most), 0.0,
        np.empty(_MOST_CELLS, np.int64), np.empty(_MOST_CELLS, np.int64),
        np.empty(_MOST_CELLS, np.int64), np.empty(_MOST_CELLS, np.int64), 0,
        np.empty(MEMBERS, np.int64), np.empty(MEMBERS, np.int64), np.empty(MEMBERS),
        np.empty(MEMBERS), np.empty(MEMBERS),
    )


@compiled
def spread(frame: Any, main: int, most: int, fan: Any, in_order: bool) -> int:
    """Find the nearest companions of a main star, at most `most`; return their number.

    Only triangles of their order of brightness are chosen where `in_order` and that is known.
    """
    in_order = in_order and frame.has_brightness
    fan.own_intensity = frame.intensity[main] if in_order else 0.0
    n = nearest(frame, main, most, fan.star, fan.separation)
    vectors, star, separation = frame.vectors, fan.star, fan.separation
    v = vectors[main]
    for i in range(n):
        u = vectors[star[i]]
        separation[i] = max(2 * np.arcsin(min(1.0, 0.5 * np.sqrt(separation[i]))), 1e-9)
        fan.log_separation[i] = np.log(separation[i])
        fan.azimuth[i] = angle_in_image(v, u)
        fan.intensity[i] = frame.intensity[star[i]] if in_order else 0.0
    return n


@compiled
def cast_by_shape(engine: Any, threshold: int) -> None:
    """Let the chosen triangles vote."""
    fan, votes, rows = engine.fan, engine.votes, engine.triangles.rows
    first, last = fan.first, fan.last
    for run in range(fan.n_runs):
        if run & _LOOK_AT_CLOCK == _LOOK_AT_CLOCK and late(engine.progress[0]):
            break
        reading = Reading(fan.units[run], MAIN_BITS, fan.orders[run])
        vote_rows(rows, votes, (first[run], last[run]), reading, threshold)
    count_waiting(votes, threshold)


@compiled
def choose_runs(engine: Any, begin: int, end: int, tolerance_rad: float) -> int:
    """Choose the rows of the triangles of companions begin to end with those before them.

    Returns how many rows there are.
    """
    fan, cell_start, rows = engine.fan, engine.triangles.cell_start, engine.triangles.rows
    n_cells = 0
    for j in range(begin, end):
        for i in range(j):
            n_cells = _choose_cells(engine, i, j, tolerance_rad, n_cells)
    first, last, units, orders = fan.first, fan.last, fan.units, fan.orders
    n, total = 0, 0
    for run in range(n_cells):
        row, row_end = cell_start[first[run]], cell_start[last[run]]
        if row_end > row and n < _MOST_RUNS:
            prefetch(rows, row)
            prefetch(rows, row_end - 1)
            first[n], last[n], units[n], orders[n] = row, row_end, units[run], orders[run]
            n += 1
            total += row_end - row
    fan.n_runs = n
    return total


@compiled
def _choose_cells(engine: Any, i: int, j: int, tolerance_rad: float, n: int) -> int:
    """Note the cells of the triangles of companions i and j, first to last, behind `n` runs.

    Returns how many runs of cells there are then.
    """
    table, fan, prior = engine.triangles, engine.fan, engine.sky.scale_prior
    grid = table.grid
    near, far = fan.separation[i], fan.separation[j]
    vague = tolerance_rad * np.sqrt(1.0 / (near * near) + 1.0 / (far * far))
    slack = tolerance_rad / far
    size = fan.log_separation[j] - table.log_spacing - SIZE_LOW
    sizes = _cells(
        size - prior.high - slack, size - prior.low + slack, SIZE_RANGE / grid.sizes, grid.sizes
    )
    if vague > _VAGUEST or sizes[0] > sizes[1]:
        return n
    ratio = fan.log_separation[j] - fan.log_separation[i] - RATIO_LOW
    ratios = _cells(ratio - vague, ratio + vague, RATIO_RANGE / grid.ratios, grid.ratios)
    to_cells = grid.angles / (2 * np.pi)
    turn = (fan.azimuth[j] - fan.azimuth[i]) % (2 * np.pi)
    turns = int(np.floor((turn - vague) * to_cells)), int(np.floor((turn + vague) * to_cells))
    units = int(np.floor(fan.azimuth[j] * (AZIMUTH_UNITS / (2 * np.pi)))) & (AZIMUTH_UNITS - 1)
    orders = _orders(fan, i, j)
    for at_ratio in range(ratios[0], ratios[1] + 1):
        for at_angle in range(turns[0], turns[1] + 1):
            if n == len(fan.first):
                return n
            cell = (at_ratio * grid.angles + at_angle % grid.angles) * grid.sizes
            first, last = cell + sizes[0], cell + sizes[1] + 1
            prefetch(table.cell_start, first)
            prefetch(table.cell_start, last)
            fan.first[n], fan.last[n], fan.units[n], fan.orders[n] = first, last, units, orders
            n += 1
    return n


@inlined
def _orders(fan: Any, i: int, j: int) -> int:
    """Return in which orders of brightness the triangle of companions i and j may stand."""
    main, first, second = fan.own_intensity, fan.intensity[i], fan.intensity[j]
    return (
        _orders_of_two(main, first, 0) & _orders_of_two(main, second, 1)
        & _orders_of_two(first, second, 2)
    )


@inlined
def _orders_of_two(one: float, other: float, bit: int) -> int:
    """Return the orders that two intensities allow; any where one of them is not known."""
    if one > _SURELY_BRIGHTER * other and other > 0.0:
        return _BRIGHTER[bit]
    if other > _SURELY_BRIGHTER * one and one > 0.0:
        return _FAINTER[bit]
    return ANY_ORDER


@compiled
def _cells(low: float, high: float, step: float, n: int) -> tuple[int, int]:
    """Return the first and the last of `n` cells that a range meets."""
    return max(int(np.floor(low / step)), 0), min(int(np.floor(high / step)), n - 1)


@inlined
def prefetch_fan(engine: Any, star: int) -> None:
    """Have the fan of a guide star fetched, for `members_at_any_scale` and `keep_agreeing`."""
    table = engine.triangles
    n = table.fan_star.shape[1]
    first, last = star * n, star * n + n - 1
    for at in (first, last):
        prefetch(table.fan_log_separation, at)
        prefetch(table.fan_azimuth, at)
        prefetch(table.fan_star, at)


@compiled
def members_at_any_scale(engine: Any, n_fan: int, cell: int, tolerance_rad: float) -> int:
    """List the companions that a guide star has at a cell's roll at any scale; return how many."""
    star, table, fan, prior = (
        cell >> ROLL_BITS, engine.triangles, engine.fan, engine.sky.scale_prior
    )
    middle = (cell & (ROLL_BINS - 1)) * (2 * np.pi / ROLL_BINS)
    own, own_azimuth = table.fan_log_separation[star], table.fan_azimuth[star]
    n = 0
    for i in range(n_fan):
        slack = tolerance_rad / fan.separation[i]
        if slack > _VAGUEST:
            continue
        log_separation = fan.log_separation[i]
        at = first_not_below(own, 0, len(own), np.float32(log_separation - prior.high - slack))
        high = log_separation - prior.low + slack
        while at < len(own) and own[at] <= high and n < MEMBERS:
            turned = own_azimuth[at] - fan.azimuth[i] - middle
            turned -= 2 * np.pi * np.floor(turned / (2 * np.pi) + 0.5)
            if abs(turned) <= 2 * np.pi / ROLL_BINS + slack:
                fan.companion[n], fan.guide[n] = i, at
                fan.log_ratio[n] = log_separation - own[at]
                fan.roll[n], fan.slack[n] = turned, slack
                n += 1
            at += 1
    return n


@compiled
def keep_agreeing(engine: Any, n: int, n_fan: int, star: int) -> tuple[int, float, float, float]:
    """Keep the members that agree with the best one in scale and roll.

    Writes their matches to the room. Returns how many there are, the log of their focal length
    over the camera's own, its tolerance, and what they are worth (`_worth`).
    """
    fan, room, fan_star = engine.fan, engine.room, engine.triangles.fan_star
    hub, most = 0, 0
    for i in range(n):
        partners = 0
        for j in range(n):
            partners += _agree(fan, i, j)
        if partners > most:
            hub, most = i, partners
    if most == 0:
        return 0, 0.0, 0.0, 0.0
    k, total, sum_log = 0, 0.0, 0.0
    for j in range(n):
        if j == hub or _agree(fan, hub, j):
            room.observed[k] = fan.star[fan.companion[j]]
            room.catalog[k] = fan_star[star, fan.guide[j]]
            weight = 1.0 / (fan.slack[j] * fan.slack[j])
            total += weight
            sum_log += weight * fan.log_ratio[j]
            k += 1
    return k, sum_log / total, 1.0 / np.sqrt(total), _worth(engine, hub, n_fan, k - 1, star)


@compiled
def _worth(engine: Any, hub: int, n_fan: int, partners: int, star: int) -> float:
    """Return -log10 of the chance that a member has so many partners.

    With the scale and roll of one member, each other companion has a star of the fan in its place
    by chance in proportion to the fan's density and the area of the tolerance (Poisson).
    """
    fan, own = engine.fan, engine.triangles.fan_log_separation[star]
    density = len(own) * np.exp(-2.0 * own[len(own) - 1])
    slack2, separation = fan.slack[hub] * fan.slack[hub], fan.separation
    at = fan.companion[hub]
    tolerance2 = slack2 * separation[at] * separation[at]
    mean = 0.0
    for i in range(n_fan):
        if i != at:
            mean += min(density * (tolerance2 + separation[i] * separation[i] * slack2), 1.0)
    if partners <= mean:
        return 0.0
    total = partners * np.log(mean) - mean
    for i in range(2, partners + 1):
        total -= np.log(i)
    return -total / np.log(10.0)


@compiled
def _agree(fan: Any, i: int, j: int) -> bool:
    """Return whether two members have one scale and roll, within their tolerances."""
    if fan.companion[i] == fan.companion[j] or fan.guide[i] == fan.guide[j]:
        return False
    scale, roll = fan.log_ratio[i] - fan.log_ratio[j], fan.roll[i] - fan.roll[j]
    slack2 = fan.slack[i] * fan.slack[i] + fan.slack[j] * fan.slack[j]
    return scale * scale + roll * roll <= slack2
