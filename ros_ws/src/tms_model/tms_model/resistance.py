"""Names of the forces that change a bicycle's speed."""

from __future__ import annotations

from typing import Literal, get_args

Resistance = Literal["rolling", "normal_ahead", "rear_brake", "front_brake"]
RESISTANCES: tuple[Resistance, ...] = get_args(Resistance)
