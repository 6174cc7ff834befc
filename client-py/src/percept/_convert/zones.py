"""Zone masks of sessions."""

from __future__ import annotations

from ..types.navigation import SpeedMask, SpeedUnit, ZoneMask
from ..v1 import session_pb2
from . import maps, words
from .toolbox import planning


def mask_to(mask: ZoneMask) -> session_pb2.ZoneMask:
    """A mask as a message."""
    out = session_pb2.ZoneMask(name=mask.name)
    if mask.cells is not None:
        given = planning.map_to(mask.cells)
        if given.HasField("nav2"):
            out.nav2.CopyFrom(given.nav2)
        else:
            out.grid.CopyFrom(given.grid)
    if mask.speed is not None:
        speed = mask.speed
        unit = words.number("speed.unit", session_pb2.SpeedUnit, speed.unit)
        out.speed.CopyFrom(session_pb2.SpeedMask(unit=unit, base=speed.base, multiplier=speed.multiplier))
    elif mask.cells is not None:
        out.keep_out = True
    return out


def mask(message: session_pb2.ZoneMask) -> ZoneMask:
    """A mask of a message, without its cells."""
    speed = None
    if message.WhichOneof("kind") == "speed":
        of = message.speed
        unit = words.word(SpeedUnit, session_pb2.SpeedUnit, of.unit)
        speed = SpeedMask(base=of.base, multiplier=of.multiplier, unit=unit)
    return ZoneMask(name=message.name, speed=speed, geometry=maps.grid_geometry(message.geometry))
