"""The changes of a design that `skin_sensitivity` solves, one number at a time."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from softslide.pipeline.sensor import Sensor

# As the article's slides; the shipped atlas's middle height.
DEPTH_MM, HEIGHT_MM = 0.5, 7.0
# The article's base: silicone of 1.2 MPa, 64 mm wide round a chamber of 50 mm and 10 mm deep; the skin is 60 mm wide.
BASE_MPA, WALL_MM, WALL_HEIGHT_MM, OVERLAP_MM = 1.2, 7.0, 10.0, 5.0
SHEAR_CORRECTION = 5 / 6  # of a rectangular section (Timoshenko's beam)


def wall_stiffness(modulus_mpa: float) -> tuple[float, float]:
    """Traction over displacement, normal and tangential, MPa/mm, of the chamber's wall under the skin that lies on it.

    The wall is a beam on a rigid floor, incompressible and in plane strain: it is compressed, or bends and shears.
    """
    stretched, sheared = modulus_mpa / (1 - 0.5**2), modulus_mpa / 3
    bending = WALL_HEIGHT_MM**3 / (3 * stretched * WALL_MM**3 / 12)
    shear = WALL_HEIGHT_MM / (SHEAR_CORRECTION * sheared * WALL_MM)
    return stretched * WALL_MM / WALL_HEIGHT_MM / OVERLAP_MM, 1 / (bending + shear) / OVERLAP_MM


def _base(share: float) -> dict[str, Any]:
    return {"overlap_mm": OVERLAP_MM, "base_mpa_mm": wall_stiffness(share * BASE_MPA)}


# Name of each change, the part of the design that it is of ("line": height and depth), and that part's new values.
CHANGES: tuple[tuple[str, str, dict[str, Any]], ...] = (
    ("design", "line", {}),
    *((f"friction {v:g}", "skin", {"friction": v}) for v in (0.0, 0.3, 0.5, 0.8)),
    *((f"height, mm {v:g}", "line", {"height_mm": v}) for v in (5.0, 6.0, 8.5)),
    *((f"depth, mm {v:g}", "line", {"depth_mm": v}) for v in (0.3, 1.0)),
    *((f"skin, mm {v:g}", "", {"skin_thickness_mm": v}) for v in (3.0, 5.0)),
    *((f"chamber, mm {v:g}", "", {"chamber_mm": (v, v)}) for v in (48.0, 54.0)),
    *((f"board's bond, mm {v:g}", "board", {"size_mm": (v, v)}) for v in (6.0, 8.0, 12.0)),
    *((f"board's thickness, mm {v:g}", "board", {"thickness_mm": v}) for v in (1.0, 2.4)),
    *((f"Young's modulus, MPa {v:g}", "skin", {"youngs_modulus_mpa": v}) for v in (0.035, 0.14)),
    *((f"bulk modulus, MPa {v:g}", "skin", {"bulk_modulus_mpa": v}) for v in (1.0, 4.0)),
    *((f"skin on the base, mm {v:g}", "skin", {"overlap_mm": v}) for v in (2.5, 5.0)),
    *((f"{OVERLAP_MM:g} mm on a base of, MPa {v * BASE_MPA:g}", "skin", _base(v)) for v in (1.0, 0.5)),
    *((f"prestretch {v:g}", "skin", {"prestretch": v}) for v in (0.98, 1.05)),
    ("edge of 10 mm across", "", {"indenter_edge_mm": (0.0, 10.0)}),
    ("edge of 10 mm along", "", {"indenter_edge_mm": (10.0, 0.0)}),
    *((f"ball, mm {v:g}", "", {"indenter_diameter_mm": v}) for v in (3.0, 12.0)),
    *((f"mesh, mm {v:g}", "mesh", {"size_mm": v}) for v in (3.4, 2.0)),
    ("mesh, two layers", "mesh", {"layers": 2}),
)  # fmt: skip


def changed(sensor: Sensor, part: str, values: Mapping[str, Any]) -> tuple[Sensor, float, float]:
    """The design with a change in it, the skin's height and the contact's depth, mm."""
    if part == "line":
        return sensor, values.get("height_mm", HEIGHT_MM), values.get("depth_mm", DEPTH_MM)
    new = {part: replace(getattr(sensor, part), **values)} if part else values
    return replace(sensor, **new), HEIGHT_MM, DEPTH_MM
