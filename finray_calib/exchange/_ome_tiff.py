"""A session as OME-TIFF: every frame as it was captured, with exposure, time, light and filter in the OME schema.

An image of the file holds the frames of one kind: its channels are the filters, its time points the exposures of each
filter in order. OME has no field for the pattern of a Bayer camera, its black level, the state of the laser or the
wheel: they are map annotations, of the camera and of every plane. Written after the OME schema of June 2016.
"""

import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import Final
from xml.etree import ElementTree

from data_schemas import naming_file
from data_schemas.storage import write_atomically
from finray_calib.exchange._session_frames import (
    DARK,
    LARGEST_PLAIN_BYTES,
    WHITE,
    FrameSink,
    Progress,
    Series,
    SessionFrame,
    SessionFrames,
    Value,
    exchangeable,
)

SCHEMA: Final = "http://www.openmicroscopy.org/Schemas/OME/2016-06"
RESOLUTION: Final = "Bayer counts of the sensor, not demosaiced: rows and columns alternate between colours"
Element = ElementTree.Element
child = ElementTree.SubElement


def write_ome_tiff(session: SessionFrames, out: Path, origin: str, progress: Progress) -> int:
    """Write the frames of a session to one new OME-TIFF, complete or absent; return the number of its images.

    Counts are stored bit for bit, uncompressed, 16 bits a sample; beyond 4 GB the file is a BigTIFF.

    Parameters
    ----------
    session
        What to write.
    out
        The file, which must be new and end in .ome.tiff or .ome.tif.
    origin
        Command and version that wrote it, as an annotation.
    progress
        Called with (done, total, text) after every frame.

    Raises
    ------
    RecordError
        Something has this name already, or a frame leads out of the session's folder.
    ChecksumError
        A frame is missing or was changed.
    """
    import tifffile

    series = session.series()
    planes = [frame for one in series for frame in plane_order(one)]
    shape = session.counts(planes[0]).shape
    description = ome_xml(session, series, shape, out.name, origin)

    def fill(handle: int) -> None:
        is_big = session.bytes_of_frames(shape) > LARGEST_PLAIN_BYTES
        with (
            naming_file(out),
            FrameSink(handle) as sink,
            tifffile.TiffWriter(sink, bigtiff=is_big, ome=False) as writer,
        ):
            for number, frame in enumerate(planes):
                writer.write(
                    session.counts(frame),
                    photometric="rgb" if len(shape) == 3 else "minisblack",
                    description=description if number == 0 else None,
                    software="finray-calib",
                    metadata=None,
                    contiguous=False,
                )
                sink.require_room()
                progress(number + 1, len(planes), frame.filter_name)

    write_atomically(out, fill)
    return len(series)


def plane_order(series: Series) -> Iterator[SessionFrame]:
    """Yield the frames of a series as they lie in the file: all channels of a time point, then the next one."""
    for time_point in zip(*series.channels, strict=True):
        yield from time_point


class _Annotations:
    """Structured annotations, numbered as they are made."""

    def __init__(self) -> None:
        self.all = Element("StructuredAnnotations")

    def refer(self, to: Element, facts: dict[str, Value], namespace: str) -> None:
        """Annotate an element with a map of what is known."""
        named = self._new("MapAnnotation", to, f"finray-calib/{namespace}")
        value = child(named, "Value")
        for name, fact in facts.items():
            if fact is not None:
                child(value, "M", K=name).text = f"{fact:.9g}" if isinstance(fact, float) else str(fact)

    def tag(self, to: Element, word: str) -> None:
        """Annotate an element with a word."""
        child(self._new("TagAnnotation", to, "finray-calib/frame-type"), "Value").text = word

    def _new(self, kind: str, to: Element, namespace: str) -> Element:
        name = f"Annotation:{len(self.all)}"
        child(to, "AnnotationRef", ID=name)
        return child(self.all, kind, ID=name, Namespace=namespace)


def ome_xml(
    session: SessionFrames, series: tuple[Series, ...], shape: tuple[int, ...], file_name: str, origin: str
) -> bytes:
    """Return the OME-XML of a session, as plain ASCII with character references.

    Characters that XML does not know, such as those of control, become U+FFFD.

    Parameters
    ----------
    session, series
        What is described.
    shape
        Of every frame, (H, W) or (H, W, 3).
    file_name
        Name of the file that holds the planes.
    origin
        Command and version that wrote it.
    """
    identity = f"urn:uuid:{uuid.uuid5(uuid.NAMESPACE_OID, f'ome-tiff {session.sha256}')}"
    top = Element("OME", {"xmlns": SCHEMA, "UUID": identity, "Creator": "finray-calib"})
    notes = _Annotations()
    top.append(_instrument(session))
    images, first_plane = [], 0
    for number, one in enumerate(series):
        image = child(top, "Image", ID=f"Image:{number}", Name=one.name)
        child(image, "AcquisitionDate").text = min(plane_order(one), key=lambda f: f.start_s).captured_utc
        child(image, "Description").text = _description(session)
        child(image, "InstrumentRef", ID="Instrument:0")
        image.append(_pixels(session, one, number, shape, (identity, file_name, first_plane), notes))
        if session.region is not None:
            child(image, "ROIRef", ID="ROI:0")
        images.append(image)
        notes.tag(image, _frame_word(one))
        first_plane += sum(len(channel) for channel in one.channels)
    for image in images:
        notes.refer(image, _camera_facts(session, shape, origin), "camera")
    top.append(notes.all)
    if session.region is not None:
        top.append(_region(session))
    for element in top.iter():
        element.text = element.text and exchangeable(element.text)
        element.attrib = {name: exchangeable(value) for name, value in element.attrib.items()}
    text: bytes = ElementTree.tostring(top, encoding="us-ascii")
    return b'<?xml version="1.0" encoding="UTF-8"?>' + text


def _frame_word(series: Series) -> str:
    """Return the word that marks dark frames, white frames and the others."""
    kind = series.channels[0][0].frame_type
    return "dark frame" if kind == DARK else "white frame" if kind in WHITE else kind


def _description(session: SessionFrames) -> str:
    return f"{session.kind} session of {session.sample} on rig {session.rig}"


def _camera_facts(session: SessionFrames, shape: tuple[int, ...], origin: str) -> dict[str, Value]:
    """Return what OME has no field for, of all frames of a session."""
    camera, laser = session.camera, session.laser
    facts: dict[str, Value] = {
        "cfa_pattern": camera.bayer_pattern if len(shape) == 2 else None,
        "cfa_meaning": RESOLUTION if len(shape) == 2 else None,
        "black_level_dn": camera.black_level_dn,
        "gain_e_per_dn": camera.gain_e_per_dn,
        "gain_db": camera.gain_db,
        "read_noise_e": camera.read_noise_e,
        "full_scale_dn": 2**camera.bit_depth - 1,
        "camera_response": camera.response,
        "delta_t_counts_from": session.first.captured_utc,
        "session_sha256": session.sha256,
        "written_by": origin,
    }
    if laser is not None:
        facts |= {"laser_class": laser.laser_class, "laser_fwhm_nm": laser.fwhm_nm}
    if session.lamp is not None:
        facts["lamp_spectrum"] = session.lamp.spectrum
    for device in session.devices:
        said = (device.vendor, device.model, device.serial, device.firmware)
        facts[f"{device.role.replace(' ', '_')}_says"] = " / ".join(part or "-" for part in (device.driver, *said))
    return facts


def _instrument(session: SessionFrames) -> Element:
    """Return the lights, the camera and the filters of the rig."""
    top = Element("Instrument", ID="Instrument:0")
    laser, lamp = session.laser, session.lamp
    if laser is not None:
        child(
            top,
            "Laser",
            {
                "ID": "LightSource:laser",
                **_named(session, "laser"),
                "Power": f"{laser.power_mw:g}",
                "PowerUnit": "mW",
                "Wavelength": f"{laser.wavelength_nm:g}",
                "WavelengthUnit": "nm",
            },
        )
    if lamp is not None:
        child(top, "Filament", {"ID": "LightSource:lamp", **_named(session, "lamp"), "Type": "Other"})
    named = _named(session, "camera")
    child(top, "Detector", {"ID": "Detector:0", **named, "Model": named.get("Model") or session.camera.model})
    wheel = session.device("filter wheel")
    for band in session.filters:
        one = child(top, "Filter", ID=f"Filter:{band.slot}", Model=band.name, Type="BandPass")
        if wheel is not None and wheel.model:
            one.set("FilterWheel", wheel.model)
        child(
            one,
            "TransmittanceRange",
            CutIn=f"{band.center_nm - 0.5 * band.fwhm_nm:g}",
            CutInUnit="nm",
            CutOut=f"{band.center_nm + 0.5 * band.fwhm_nm:g}",
            CutOutUnit="nm",
            Transmittance=f"{band.peak_transmission:g}",
        )
    return top


def _named(session: SessionFrames, role: str) -> dict[str, str]:
    """Return maker, model and serial number of a device as attributes; those that it does not say are left out."""
    device = session.device(role)
    if device is None:
        return {}
    said = {"Manufacturer": device.vendor, "Model": device.model, "SerialNumber": device.serial}
    return {name: text for name, text in said.items() if text}


def _pixels(
    session: SessionFrames,
    series: Series,
    number: int,
    shape: tuple[int, ...],
    place: tuple[str, str, int],
    notes: _Annotations,
) -> Element:
    """Return the channels, the places of the planes in the file, and what is known of each plane."""
    samples = shape[2] if len(shape) == 3 else 1
    top = Element(
        "Pixels",
        ID=f"Pixels:{number}",
        DimensionOrder="XYCTZ",
        Type="uint16",
        SignificantBits=str(session.camera.bit_depth),
        BigEndian="false",
        Interleaved="true" if samples > 1 else "false",
        SizeX=str(shape[1]),
        SizeY=str(shape[0]),
        SizeC=str(samples * len(series.channels)),
        SizeT=str(len(series.channels[0])),
        SizeZ="1",
    )
    if session.mm_per_px is not None:
        for axis in "XY":
            top.set(f"PhysicalSize{axis}", f"{session.mm_per_px:.9g}")
            top.set(f"PhysicalSize{axis}Unit", "mm")
    for c, channel in enumerate(series.channels):
        top.append(_channel(session, channel[0], f"Channel:{number}:{c}", samples))
    identity, file_name, first = place
    indices = [(c, t) for t in range(len(series.channels[0])) for c in range(len(series.channels))]
    for offset, (c, t) in enumerate(indices):
        data = child(top, "TiffData", _place(samples * c, t, "First") | {"IFD": str(first + offset), "PlaneCount": "1"})
        child(data, "UUID", FileName=file_name).text = identity
    for (c, t), frame in zip(indices, plane_order(series), strict=True):
        plane = child(top, "Plane", _place(samples * c, t, "The"))
        plane.attrib |= {"DeltaT": f"{frame.start_s:.9g}", "DeltaTUnit": "s"}
        if frame.exposure_s is not None:
            plane.attrib |= {"ExposureTime": f"{frame.exposure_s:.9g}", "ExposureTimeUnit": "s"}
        notes.refer(plane, frame.known(), "frame")
    return top


def _place(channel: int, time_point: int, word: str) -> dict[str, str]:
    """Return the attributes of a place in an image: FirstC or TheC, and so on."""
    return {f"{word}C": str(channel), f"{word}T": str(time_point), f"{word}Z": "0"}


def _channel(session: SessionFrames, frame: SessionFrame, name: str, samples: int) -> Element:
    """Return a channel: its filter, and its light where one shines."""
    top = Element("Channel", ID=name, Name=frame.filter_name, SamplesPerPixel=str(samples))
    source = {"laser": "laser", "lamp": "lamp"}.get(frame.light or "")
    if source == "laser" and session.laser is not None:
        top.attrib |= {
            "ExcitationWavelength": f"{session.laser.wavelength_nm:g}",
            "ExcitationWavelengthUnit": "nm",
            "IlluminationType": "Epifluorescence",
        }
    if frame.band is not None and source is not None:  # of a dark frame nothing is seen through the filter
        top.attrib |= {"EmissionWavelength": f"{frame.band.center_nm:g}", "EmissionWavelengthUnit": "nm"}
    if source is not None:
        settings = child(top, "LightSourceSettings", ID=f"LightSource:{source}")
        if source == "laser" and session.laser is not None:
            settings.attrib |= {"Wavelength": f"{session.laser.wavelength_nm:g}", "WavelengthUnit": "nm"}
    child(top, "DetectorSettings", ID="Detector:0", Binning="1x1")
    if frame.band is not None:
        child(child(top, "LightPath"), "EmissionFilterRef", ID=f"Filter:{frame.band.slot}")
    return top


def _region(session: SessionFrames) -> Element:
    """Return the region of the session as a rectangle."""
    region = session.region
    top = Element("ROI", ID="ROI:0", Name="region of the session")
    if region is not None:
        corner = {"X": region.column_px, "Y": region.row_px, "Width": region.width_px, "Height": region.height_px}
        sides = {name: str(value) for name, value in corner.items()}
        child(child(top, "Union"), "Rectangle", {"ID": "Shape:0:0", **sides})
    return top
