"""A session as NeXus (HDF5), and as the documents of bluesky that point into such a file.

The NeXus file holds all frames in one stack as the default plot, the camera as NXdetector with exposure and start of
every frame, the filters, laser and lamp, and the sample. What a session does not know, such as the distance of the
camera, is left out. Documents follow the event model: a start, one stream of events with a stream resource for the
frames, a stop.
"""

import json
import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from data_schemas import BandPassFilter, MissingExtraError, naming_file
from data_schemas.storage import refuse_existing, write_atomically, write_bytes
from finray_calib.exchange._session_frames import FrameSink, Progress, SessionFrame, SessionFrames, exchangeable

if TYPE_CHECKING:
    from h5py import Group

STACK: Final = "/entry/instrument/camera/data"
"""Where the frames lie in the file."""
STREAM: Final = "primary"
PIXELS: Final = "camera_frame"


def write_nexus(session: SessionFrames, out: Path, origin: str, progress: Progress) -> int:
    """Write a session to one new NeXus file, complete or absent; return the number of its frames.

    Parameters
    ----------
    session
        What to write.
    out
        The file, which must be new.
    origin
        Command and version that wrote it.
    progress
        Called with (done, total, text) after every frame.

    Raises
    ------
    MissingExtraError
        h5py is not installed.
    RecordError
        Something has this name already, or a frame leads out of the session's folder.
    ChecksumError
        A frame is missing or was changed.
    """
    try:
        import h5py
    except ImportError as error:
        raise MissingExtraError(
            f"NeXus files need h5py ({error}); install it with pip install 'finray-calib[nexus]'"
        ) from None

    def fill(handle: int) -> None:
        with naming_file(out), FrameSink(handle) as sink, h5py.File(sink, "w", libver=("earliest", "v110")) as file:
            file.attrs.update({"NX_class": "NXroot", "default": "entry", "creator": "finray-calib"})

            def stored(done: int, total: int, text: str) -> None:
                sink.require_room()
                progress(done, total, text)

            _fill_entry(_group(file, "entry", "NXentry"), session, origin, stored)

    write_atomically(out, fill)
    return len(session.frames)


def _group(parent: "Group", name: str, kind: str) -> "Group":
    """Return a new group of a NeXus class."""
    group = parent.create_group(name)
    group.attrs["NX_class"] = kind
    return group


def _put(group: "Group", name: str, value: Any, units: str = "", **attributes: Any) -> None:
    """Add a field with its units; one that is not known is left out. HDF5 refuses some characters of a text."""
    if value is None:
        return
    if isinstance(value, list):
        value = [exchangeable(text) for text in value]
    group[name] = exchangeable(value) if isinstance(value, str) else value
    group[name].attrs.update(({"units": units} if units else {}) | attributes)


def _fill_entry(entry: "Group", session: SessionFrames, origin: str, progress: Progress) -> None:
    """Write everything below the entry."""
    first, last = session.first, session.frames[-1]
    entry.attrs["default"] = "data"
    _put(entry, "title", f"{session.kind} session of {session.sample}")
    _put(entry, "start_time", first.captured_utc)
    _put(entry, "end_time", last.captured_utc)
    _put(entry, "entry_identifier", session.sha256)
    _put(entry, "program_name", "finray-calib", configuration=origin)
    if session.notes:
        note = _group(entry, "notes", "NXnote")
        _put(note, "type", "text/plain")
        _put(note, "data", "\n".join(session.notes))
    instrument = _group(entry, "instrument", "NXinstrument")
    _put(instrument, "name", session.rig)
    _fill_camera(_group(instrument, "camera", "NXdetector"), session, progress)
    _fill_lights(instrument, session)
    for band in session.filters:
        _fill_filter(_group(instrument, f"filter_{band.slot}", "NXfilter"), session, band)
    sample = _group(entry, "sample", "NXsample")
    _put(sample, "name", session.sample)
    _put(sample, "type", "sample")
    _fill_frames(_group(entry, "frames", "NXcollection"), session)
    _fill_plot(entry, session)


def _fill_camera(camera: "Group", session: SessionFrames, progress: Progress) -> None:
    """Write the frames, with the exposure and the start of each."""
    settings, frames = session.camera, session.frames
    shape = session.counts(frames[0]).shape
    stack = camera.create_dataset("data", (len(frames), *shape), "<u2", chunks=(1, *shape))
    stack.attrs.update({"units": "counts", "interpretation": "image" if len(shape) == 2 else "rgb-image"})
    for number, frame in enumerate(frames):
        stack[number] = session.counts(frame)
        progress(number + 1, len(frames), frame.filter_name)
    exposures_s = np.array([np.nan if f.exposure_s is None else f.exposure_s for f in frames])
    starts_s = np.array([frame.start_s for frame in frames])
    start = session.first.captured_utc
    said = session.device("camera")
    _put(camera, "description", (said.model if said is not None else "") or settings.model)
    _put(camera, "serial_number", (said.serial if said is not None else "") or None)
    _put(camera, "count_time", exposures_s, "s")
    _put(camera, "start_time", starts_s, "s", start=start)
    _put(camera, "stop_time", starts_s + exposures_s, "s", start=start)
    _put(camera, "sequence_number", np.array([frame.sequence for frame in frames]))
    _put(camera, "bit_depth_readout", settings.bit_depth)
    _put(camera, "saturation_value", 2**settings.bit_depth - 1)
    _put(camera, "layout", "area")
    more = _group(camera, "settings", "NXcollection")
    _put(more, "cfa_pattern", settings.bayer_pattern if len(shape) == 2 else None)
    _put(more, "black_level", settings.black_level_dn, "counts")
    _put(more, "gain", settings.gain_e_per_dn, "electrons/count")
    _put(more, "gain_db", settings.gain_db, "dB")
    _put(more, "read_noise", settings.read_noise_e, "electrons")
    _put(more, "side_of_a_pixel_on_the_pad", session.mm_per_px, "mm")
    if (region := session.region) is not None:
        _put(more, "region", np.array([region.row_px, region.column_px, region.height_px, region.width_px]), "pixels")
        more["region"].attrs["meaning"] = "first row, first column, rows, columns"


def _fill_lights(instrument: "Group", session: SessionFrames) -> None:
    """Write laser and lamp, and the wavelength of the laser's beam."""
    laser, lamp = session.laser, session.lamp
    if laser is not None:
        source = _group(instrument, "laser", "NXsource")
        _put(source, "name", f"laser of class {laser.laser_class}")
        _put(source, "type", "Laser")
        _put(source, "probe", "visible light")
        _put(source, "power", laser.power_mw, "mW")
        beam = _group(instrument, "laser_beam", "NXbeam")
        _put(beam, "incident_wavelength", laser.wavelength_nm, "nm")
        _put(beam, "incident_wavelength_spread", laser.fwhm_nm, "nm")
    if lamp is not None:
        source = _group(instrument, "lamp", "NXsource")
        _put(source, "name", f"lamp, {lamp.spectrum}")
        _put(source, "probe", "visible light")


def _fill_filter(group: "Group", session: SessionFrames, band: BandPassFilter) -> None:
    """Write a filter, with its measured transmission where there is one."""
    _put(group, "description", f"band-pass filter {band.name}")
    more = _group(group, "band", "NXcollection")  # NXfilter has no fields for these
    _put(more, "name", band.name)
    _put(more, "slot", band.slot)
    _put(more, "wavelength", band.center_nm, "nm", uncertainty=band.center_uncertainty_nm)
    _put(more, "bandwidth", band.fwhm_nm, "nm", uncertainty=band.fwhm_uncertainty_nm)
    _put(more, "peak_transmission", band.peak_transmission)
    if (curve := session.curves.get(band.name)) is not None:
        plot = _group(group, "transmission", "NXdata")
        plot.attrs.update({"signal": "transmission", "axes": ["wavelength"]})
        _put(plot, "wavelength", curve.wavelength_nm, "nm")
        _put(plot, "transmission", curve.values)


def _fill_frames(table: "Group", session: SessionFrames) -> None:
    """Write what is known of each frame, a column for each fact."""
    rows = [frame.known() for frame in session.frames]
    for name in dict.fromkeys(name for row in rows for name in row):
        column = [row.get(name) for row in rows]
        if any(isinstance(value, str) for value in column):
            _put(table, name, ["" if value is None else str(value) for value in column])
        elif any(value is not None for value in column):
            _put(table, name, np.array([np.nan if value is None else value for value in column]))
    centers_nm = [np.nan if frame.band is None else frame.band.center_nm for frame in session.frames]
    _put(table, "filter_wavelength", np.array(centers_nm), "nm")


def _fill_plot(entry: "Group", session: SessionFrames) -> None:
    """Make the stack of frames the default plot."""
    plot = _group(entry, "data", "NXdata")
    plot["data"] = entry[STACK]  # a hard link: the frames are there once
    _, rows, columns, *samples = plot["data"].shape
    plot.attrs.update({"signal": "data", "axes": ["frame", "row", "column", *("." for _ in samples)]})
    _put(plot, "frame", np.array([frame.sequence for frame in session.frames]), long_name="number of the frame")
    _put(plot, "row", np.arange(rows), "pixels")
    _put(plot, "column", np.arange(columns), "pixels")
    for place, axis in enumerate(("frame", "row", "column")):
        plot.attrs[f"{axis}_indices"] = place
    _put(plot, "title", f"{session.kind} session of {session.sample}")


def write_bluesky_documents(session: SessionFrames, out: Path, origin: str, progress: Progress) -> int:
    """Write a session as bluesky documents, one a line, and its frames to the NeXus file beside; return the events.

    Parameters
    ----------
    session
        What to write.
    out
        File of the documents, which must be new; the frames go to the same name with the ending .nxs.
    origin
        Command and version that wrote it.
    progress
        Called with (done, total, text) after every frame.

    Raises
    ------
    MissingExtraError
        h5py is not installed.
    RecordError
        Something has one of these names already, or a frame leads out of the session's folder.
    ChecksumError
        A frame is missing or was changed.
    """
    frames = out.with_suffix(".nxs")
    refuse_existing(out)
    documents = list(bluesky_documents(session, frames, origin))
    lines = "".join(f"{json.dumps(document, allow_nan=False)}\n" for document in documents)
    write_nexus(session, frames, origin, progress)
    try:
        write_bytes(out, lines.encode("ascii"))
    except BaseException:
        frames.unlink()
        raise
    return len(session.frames)


def bluesky_documents(session: SessionFrames, frames: Path, origin: str) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield name and content of the documents of a session: start, descriptor, stream resource and datum, events, stop.

    The same session gives the same documents.

    Parameters
    ----------
    session
        What is described.
    frames
        The NeXus file of the session that the documents point to.
    origin
        Command and version that wrote it.
    """
    start, descriptor, resource = (_unique(session, name) for name in ("start", "descriptor", "frames"))
    times_s = [frame.start_unix_s + (frame.exposure_s or 0.0) for frame in session.frames]
    shape = session.counts(session.frames[0]).shape
    yield "start", _run_start(session, start, origin)
    yield "descriptor", {"uid": descriptor, "run_start": start, **_descriptor(session, shape, times_s[0])}
    yield (
        "stream_resource",
        {
            "uid": resource,
            "run_start": start,
            "data_key": PIXELS,
            "mimetype": "application/x-hdf5",
            "uri": f"file://localhost{frames.resolve().as_posix()}",
            "parameters": {"dataset": STACK, "chunk_shape": [1, *shape], "swmr": False},
        },
    )
    for number, (frame, time_s) in enumerate(zip(session.frames, times_s, strict=True), 1):
        data = _event_data(frame)
        event = {"uid": _unique(session, f"event {number}"), "descriptor": descriptor, "time": time_s}
        event |= {"seq_num": number, "data": data, "timestamps": dict.fromkeys(data, time_s), "filled": {}}
        yield "event", event
    count = len(session.frames)
    yield (
        "stream_datum",
        {
            "uid": f"{resource}/0",
            "stream_resource": resource,
            "descriptor": descriptor,
            "indices": {"start": 0, "stop": count},
            "seq_nums": {"start": 1, "stop": count + 1},
        },
    )
    ended = {"uid": _unique(session, "stop"), "run_start": start, "time": max(times_s), "reason": ""}
    yield "stop", ended | {"exit_status": "success", "num_events": {STREAM: count}}


def _unique(session: SessionFrames, name: str) -> str:
    """Return an identifier that is the same for the same session."""
    return str(uuid.uuid5(uuid.NAMESPACE_OID, f"{name} {session.sha256}"))


def _descriptor(session: SessionFrames, shape: tuple[int, ...], time_s: float) -> dict[str, Any]:
    """Return what the events hold, and the settings that hold for all of them."""
    keys = _data_keys(session, shape)
    return {
        "time": time_s,
        "name": STREAM,
        "data_keys": keys,
        "object_keys": {"camera": [PIXELS], "frame": [key for key in keys if key != PIXELS]},
        "configuration": {"camera": _configuration(session, time_s)},
        "hints": {"frame": {"fields": ["saturated_fraction"]}},
    }


def _run_start(session: SessionFrames, uid: str, origin: str) -> dict[str, Any]:
    return {
        "uid": uid,
        "time": session.frames[0].start_unix_s,
        "plan_name": f"finray_capture_{session.kind}",
        "plan_type": "generator",
        "sample": session.sample,
        "rig": session.rig,
        "detectors": ["camera"],
        "motors": ["filter_wheel"] if session.filters else [],
        "num_points": len(session.frames),
        "hints": {"dimensions": [[["elapsed_s"], STREAM]]},
        "session_sha256": session.sha256,
        "written_by": origin,
    }


def _data_keys(session: SessionFrames, shape: tuple[int, ...]) -> dict[str, Any]:
    """Return what the events and the stream resource hold."""
    source = f"finray:{session.rig}"
    keys: dict[str, Any] = {
        PIXELS: {
            "source": f"{source}/camera",
            "dtype": "array",
            "dtype_numpy": "<u2",
            "shape": [1, *shape],
            "external": "STREAM:",
            "units": "DN",
        }
    }
    for name, value in _event_data(session.frames[0]).items():
        dtype = "string" if isinstance(value, str) else "integer" if isinstance(value, int) else "number"
        keys[name] = {"source": f"{source}/frame", "dtype": dtype, "shape": []}
        for ending, units in (("_s", "s"), ("_nm", "nm"), ("_j", "J"), ("_deg", "deg")):
            if name.endswith(ending):
                keys[name]["units"] = units
    return keys


def _event_data(frame: SessionFrame) -> dict[str, str | int | float]:
    """Return the numbers and words of a frame's event; without a filter its wavelength is 0."""
    exposure = {} if frame.exposure_s is None else {"exposure_s": frame.exposure_s}
    return {
        "sequence": frame.sequence,
        "frame_type": frame.frame_type,
        "target": frame.target or "",
        "light": frame.light or "",
        "filter": frame.filter_name,
        "filter_center_nm": 0.0 if frame.band is None else frame.band.center_nm,
        **exposure,
        "elapsed_s": frame.start_s,
        "laser_dose_j": float(frame.facts.get("laser_dose_j") or 0.0),
        "saturated_fraction": float(frame.facts.get("saturated_fraction") or 0.0),
        "file": frame.file,
        "sha256": frame.sha256,
    }


def _configuration(session: SessionFrames, time_s: float) -> dict[str, Any]:
    """Return the settings that hold for all frames."""
    camera, laser = session.camera, session.laser
    data: dict[str, Any] = {
        "cfa_pattern": camera.bayer_pattern,
        "bit_depth": camera.bit_depth,
        "black_level_dn": camera.black_level_dn,
        "gain_e_per_dn": camera.gain_e_per_dn,
    }
    if laser is not None:
        data["laser_wavelength_nm"] = laser.wavelength_nm
    kinds = {str: "string", int: "integer", float: "number"}
    return {
        "data": data,
        "timestamps": dict.fromkeys(data, time_s),
        "data_keys": {
            name: {"source": f"finray:{session.rig}/camera", "dtype": kinds[type(value)], "shape": []}
            for name, value in data.items()
        },
    }
