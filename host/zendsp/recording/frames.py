"""A recording as a pandas or xarray object, where these are installed."""

from __future__ import annotations

from typing import TYPE_CHECKING

from zendsp.errors import RecordingError

if TYPE_CHECKING:
    import pandas
    import xarray

    from zendsp.recording.recording import Recording


def to_pandas(recording: Recording) -> pandas.DataFrame:
    """See :meth:`Recording.to_pandas`."""
    try:
        import pandas
    except ImportError as error:
        raise RecordingError("to_pandas() needs pandas: pip install 'zendsp[frames]'") from error
    index = pandas.Index(recording.t, name="t")
    frame = pandas.DataFrame(recording.data, index=index, columns=list(recording.columns))
    frame.attrs["units"] = dict(zip(recording.columns, recording.column_units, strict=True))
    return frame


def to_xarray(recording: Recording) -> xarray.Dataset:
    """See :meth:`Recording.to_xarray`."""
    try:
        import xarray
    except ImportError as error:
        raise RecordingError("to_xarray() needs xarray: pip install 'zendsp[frames]'") from error
    variables = {}
    for channel in recording.channels:
        values = recording[channel.name]
        dims = ("t",) if values.ndim == 1 else ("t", f"{channel.name}_index")
        variables[channel.name] = (dims, values, {"units": channel.unit})
    attributes = {"machine": recording.machine, "sample_time": recording.sample_time, "lost": recording.lost}
    return xarray.Dataset(variables, coords={"t": ("t", recording.t, {"units": "s"})}, attrs=attributes)
