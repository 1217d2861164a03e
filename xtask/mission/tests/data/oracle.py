"""Writes projection.csv, areas.json and clothoids.csv: known answers of PROJ (pyproj), GEOS (shapely) and of E. Bertolazzi's
library of clothoids (pyclothoids).

Run it by hand after a change (pip install pyproj shapely pyclothoids):

    python xtask/mission/tests/data/oracle.py

`tests/projection.rs`, `tests/field.rs` and the tests of `src/curve/hermite.rs` compare with these numbers. The tests need no Python.
"""

import json
import math
import pathlib
import random

import pyclothoids
import pyproj
import shapely

FOLDER = pathlib.Path(__file__).parent


def projection():
    """Places around some origins in the tangent plane, at the height of the origin."""
    rng = random.Random(1)
    rows = ["origin latitude,origin longitude,height,latitude,longitude,north,east"]
    for latitude, longitude, height in [
        (40.83, -96.66, 330.0),
        (51.0, 7.0, 0.0),
        (-33.9, 151.2, 40.0),
        (68.5, 27.1, 150.0),
        (0.1, 0.0, 1200.0),
    ]:
        to_plane = pyproj.Transformer.from_pipeline(
            "+proj=pipeline +step +proj=cart +ellps=WGS84 +step +proj=topocentric +ellps=WGS84 "
            f"+lat_0={latitude} +lon_0={longitude} +h_0={height}"
        )
        for distance in [10.0, 300.0, 1000.0, 10000.0]:
            for _ in range(4):
                angle = rng.uniform(0, 2 * math.pi)
                there, beyond, _ = pyproj.Geod(ellps="WGS84").fwd(
                    longitude, latitude, math.degrees(angle), distance
                )
                east, north, _ = to_plane.transform(there, beyond, height)
                rows.append(
                    f"{latitude},{longitude},{height},{beyond:.13f},{there:.13f},{north:.7f},{east:.7f}"
                )
    (FOLDER / "projection.csv").write_text("\n".join(rows) + "\n")


def star(rng, count, radius):
    """A field without crossings: corners in order around a centre, [north, east]."""
    angles = sorted(rng.uniform(0, 2 * math.pi) for _ in range(count))
    corners = []
    for angle in angles:
        length = radius * rng.uniform(0.6, 1.0)
        corners.append((round(length * math.cos(angle), 3), round(length * math.sin(angle), 3)))
    return corners


def areas():
    """Areas of fields, and of what a headland of mitred corners leaves of them."""
    rng = random.Random(2)
    fields = []
    while len(fields) < 30:
        outer = star(rng, rng.randint(4, 25), rng.uniform(40, 200))
        field = shapely.Polygon(outer)
        holes = []
        if len(fields) % 3 == 0:
            hole = star(rng, 6, 6.0)
            if field.buffer(-1).contains(shapely.Polygon(hole)):
                holes.append(hole)
        field = shapely.Polygon(outer, holes)
        if not field.is_valid:
            continue
        width = round(rng.uniform(1, 8), 2)
        # Arcs of 4096 pieces a quarter: the area is that of true arcs to some 1e-7 of itself.
        inner = field.buffer(-width, quad_segs=4096)
        fields.append(
            {
                "outer": outer,
                "holes": holes,
                "headland": width,
                "area": field.area,
                "inner": inner.area,
            }
        )
    (FOLDER / "areas.json").write_text(json.dumps(fields, indent=1) + "\n")


def clothoids():
    """The clothoid from the origin to another pose: x north, y east, angles clockwise."""
    rng = random.Random(3)
    rows = ["heading,north,east,heading at the end,curvature,sharpness,length"]
    for _ in range(60):
        first, second = rng.uniform(-1.5, 1.5), rng.uniform(-1.5, 1.5)
        chord, bearing = 10 ** rng.uniform(-1, 2), rng.uniform(-3, 3)
        to = (chord * math.cos(bearing), chord * math.sin(bearing))
        start, end = bearing + first, bearing + second
        found = pyclothoids.Clothoid.G1Hermite(0, 0, start, *to, end)
        values = [start, *to, end, found.KappaStart, found.dk, found.length]
        rows.append(",".join(repr(value) for value in values))
    (FOLDER / "clothoids.csv").write_text("\n".join(rows) + "\n")


projection()
areas()
clothoids()
