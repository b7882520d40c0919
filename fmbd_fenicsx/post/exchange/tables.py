"""Time histories for other tools: a labelled data set (xarray, netCDF) and a table (pandas). Both libraries are optional."""

from __future__ import annotations

from typing import Any

from ...errors import InputError
from ...run.result import Run
from ..plot import components


def to_xarray(run: Run) -> Any:
    """An ``xarray.Dataset`` of all sensors and energies over time, with units and the names of components."""
    try:
        import xarray
    except ImportError as error:
        raise InputError("run.to_xarray() needs xarray: ./with-dolfinx pip install xarray.") from error

    variables: dict[str, Any] = {}
    coordinates: dict[str, Any] = {"time": ("time", run.times, {"units": "s", "long_name": "time"})}
    for sensor, values in run.series.items():
        labels = components(run, sensor)
        about = {"units": run.scene.sensors[sensor].unit, "long_name": sensor}
        if len(labels) == 1:
            variables[sensor] = ("time", values[:, 0], about)
            continue
        along = f"{sensor} component"
        coordinates[along] = (along, [label.removeprefix(sensor).strip() for label in labels])
        variables[sensor] = (("time", along), values, about)
    for kind, energy in run.energy.items():
        variables[f"{kind} energy"] = ("time", energy, {"units": "J", "long_name": f"{kind} energy"})

    return xarray.Dataset(variables, coordinates, attrs=_about_run(run))


def _about_run(run: Run) -> dict[str, Any]:
    """What a reader of the file wants to know of the run; text and numbers only, as netCDF takes them."""
    from ... import __version__

    known = {"scene": run.scene.name, "scheme": run.scheme.name, "step size (s)": float(run.dt), "status": run.status}
    errors = {f"estimated error of {name}": float(x) for name, x in run.error_estimate.items()}
    return {**known, **errors, "made by": f"fmbd_fenicsx {__version__}"}


def to_pandas(run: Run) -> Any:
    """A ``pandas.DataFrame`` over time, one column for each component: "tip x (m)"."""
    try:
        import pandas
    except ImportError as error:
        raise InputError("run.to_pandas() needs pandas: ./with-dolfinx pip install pandas.") from error

    columns: dict[str, Any] = {}
    for sensor, values in run.series.items():
        unit = run.scene.sensors[sensor].unit
        columns |= {f"{label} ({unit})": x for label, x in zip(components(run, sensor), values.T, strict=True)}
    columns |= {f"{kind} energy (J)": energy for kind, energy in run.energy.items()}

    return pandas.DataFrame(columns, index=pandas.Index(run.times, name="time (s)"))
