"""Bicycle that a recording or a live run states."""

from __future__ import annotations

from tms_bag.samples import RunInfo
from tms_model import Bicycle, ParameterError, bicycle_names, load_bicycle
from tms_model.stated_bicycle import bicycle_from_numbers


def stated_bicycle(info: RunInfo | None) -> Bicycle:
    """The catalogue's bicycle that a run_info names, else one of the parameters that it states.

    Another name is never opened as a file. Raises ParameterError where it states no bicycle.
    """
    if info is None or not info.bicycle:
        raise ParameterError("expected a run_info that names a bicycle, found none")
    if info.bicycle in bicycle_names():
        return load_bicycle(info.bicycle)
    return bicycle_from_numbers(info.bicycle, info.parameters)
