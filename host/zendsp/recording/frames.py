"""Recordings as pandas or xarray objects, where these are installed."""

from __future__ import annotations

from typing import TYPE_CHECKING

from zendsp.errors import RecordingError
from zendsp.extras import need

if TYPE_CHECKING:
    import pandas
    import xarray

    from zendsp.recording.samples import Samples


def to_pandas(recording: Samples) -> pandas.DataFrame:
    """See `Recording.to_pandas`."""
    pd = need("pandas", "frames", "to_pandas()", RecordingError)
    index = pd.Index(recording.t, name="t")
    frame: pandas.DataFrame = pd.DataFrame(
        recording.data, index=index, columns=list(recording.columns)
    )
    frame.attrs["units"] = dict(zip(recording.columns, recording.column_units, strict=True))
    return frame


def to_xarray(recording: Samples) -> xarray.Dataset:
    """See `Recording.to_xarray`."""
    xr = need("xarray", "frames", "to_xarray()", RecordingError)
    variables = {}
    for channel in recording.channels:
        values = recording[channel.name]
        dims = ("t",) if values.ndim == 1 else ("t", f"{channel.name}_index")
        variables[channel.name] = (dims, values, {"units": channel.unit})
    attributes = {
        "machine": recording.machine, "sample_time": recording.sample_time, "lost": recording.lost,
    }
    dataset: xarray.Dataset = xr.Dataset(
        variables, coords={"t": ("t", recording.t, {"units": "s"})}, attrs=attributes
    )
    return dataset
