"""The INDI parser, the address and the FITS reader against recorded and against arbitrary bytes."""

import base64
import contextlib
import socket
import threading
import time
import zlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from data_schemas import BadFrameError, LostError, RefusedError, TimedOutError
from rigs.cameras.indi import BLOCK_BYTES, read_fits_image
from rigs.lights.indi import open_switch
from rigs.transports import IndiClient, blob_bytes, indi_address, new_vector
from rigs.transports import _indi_messages as indi_messages
from rigs.transports._indi_client import IndiAddress, devices_at
from rigs.transports._indi_messages import IndiElement, IndiMessage, IndiReader, get_properties, number
from tests.capture.drivers.programs import free_port
from tests.capture.drivers.serial_replay import TRANSCRIPTS, read_transcript, replayed

LIGHT = b"".join(said for who, said in read_transcript(TRANSCRIPTS / "indi_light_panel.txt") if who == "device")


def fits(counts: np.ndarray, **cards: str) -> bytes:
    """A FITS file as INDI sends it."""
    height, width = counts.shape
    head = {"SIMPLE": "T", "BITPIX": "16", "NAXIS": "2", "NAXIS1": str(width), "NAXIS2": str(height), "BZERO": "32768"}
    lines = "".join(f"{key:<8}= {value:>20}".ljust(80) for key, value in {**head, **cards}.items()) + "END".ljust(80)
    stored = (counts.astype(np.int32) - 32768).astype(">i2").tobytes()
    return lines.encode().ljust(-(-len(lines) // BLOCK_BYTES) * BLOCK_BYTES) + stored


def test_a_recorded_stream_gives_the_same_messages_in_any_pieces() -> None:
    whole = IndiReader("light").feed(LIGHT)
    bytewise = IndiReader("light")
    assert [message for byte in LIGHT for message in bytewise.feed(bytes([byte]))] == whole
    last = [message for message in whole if message.tag == "setSwitchVector" and message.name == "FLAT_LIGHT_CONTROL"][
        -1
    ]
    assert {element.name: element.text for element in last.elements} == {"FLAT_LIGHT_ON": "Off", "FLAT_LIGHT_OFF": "On"}
    assert last.attributes["state"] == "Ok"


def test_a_message_is_there_as_soon_as_its_last_byte() -> None:
    reader = IndiReader("light")
    assert reader.feed(b'<message device="A" ') == []
    assert reader.feed(b'message="hot"/>') == [IndiMessage("message", {"device": "A", "message": "hot"})]


def test_letters_of_another_encoding_do_not_end_the_session() -> None:
    (message,) = IndiReader("wheel").feed(b'<message device="A" message="filter n\xb0 3"/>')
    assert message.attributes["message"] == "filter n� 3"
    (message,) = IndiReader("wheel").feed(b'<message device="A" message="\x1b[31mjammed\xef\xbf\xbf\t"/>')
    assert message.attributes["message"] == "�[31mjammed� "


@pytest.mark.parametrize(
    ("data", "why"),
    [
        (b'<!DOCTYPE a [<!ENTITY b "c">]><a/>', "not well-formed"),
        (b"<a>&b;</a>", "undefined entity"),
        (b"HTTP/1.0 400 Bad Request\r\n\r\n</root>", "without a start"),
        (b"<a><b><c/></b></a>", "<c> inside <b>"),
        (b"<a></b>", "mismatched tag"),
        (b"<a>\x00</a>", "not well-formed"),
    ],
)
def test_what_is_no_indi_is_lost(data: bytes, why: str) -> None:
    with pytest.raises(LostError, match=f"sends .*({why}).*check that an INDI server listens"):
        IndiReader("light").feed(data)


@pytest.mark.parametrize("start", [b"<setTextVector>", b"<a b='", b"<setTextVector><oneText>", b""])
def test_a_message_without_an_end_is_lost(start: bytes) -> None:
    reader = IndiReader("light")
    with pytest.raises(LostError, match="a message longer than 1048576 bytes"):
        reader.feed(start + b"x" * 2_200_000)


def test_a_frame_may_be_longer_than_other_messages(monkeypatch: pytest.MonkeyPatch) -> None:
    text = base64.b64encode(bytes(2 * indi_messages.LONGEST_MESSAGE_BYTES))
    reader = IndiReader("camera")
    (message,) = reader.feed(
        b'<setBLOBVector device="A" name="B"><oneBLOB name="B">' + text + b"</oneBLOB></setBLOBVector>"
    )
    assert blob_bytes(message.elements[0], "camera") == bytes(2 * indi_messages.LONGEST_MESSAGE_BYTES)
    monkeypatch.setattr(indi_messages, "_LONGEST_BLOB_MESSAGE_BYTES", 2**20)
    with pytest.raises(LostError, match="a message longer than 1048576 bytes"):
        reader.feed(b"<setBLOBVector><oneBLOB>" + text * 2)


@given(st.lists(st.binary(max_size=200), max_size=5))
def test_arbitrary_bytes_are_messages_or_lost(pieces: list[bytes]) -> None:
    reader = IndiReader("light")
    try:
        messages = [message for piece in pieces for message in reader.feed(piece)]
    except LostError as error:
        said = str(error)
    else:
        said = "light"
        assert all(isinstance(message, IndiMessage) for message in messages)
    assert said.startswith("light")


@given(st.integers(0, len(LIGHT) - 1), st.binary(min_size=1, max_size=20), st.data())
def test_a_damaged_stream_is_messages_or_lost(at: int, instead: bytes, data: st.DataObject) -> None:
    damaged = LIGHT[:at] + instead + LIGHT[at + data.draw(st.integers(0, 20)) :]
    try:
        messages = IndiReader("light").feed(damaged)
    except LostError:
        return
    assert all(isinstance(message, IndiMessage) for message in messages)


PRINTABLE = st.text(st.characters(min_codepoint=0x20, max_codepoint=0x2FFF, exclude_characters="\x7f"), max_size=30)


@given(PRINTABLE, PRINTABLE, PRINTABLE)
def test_requests_are_one_well_formed_message(device: str, name: str, value: str) -> None:
    (vector,) = IndiReader("server").feed(new_vector("Text", device, name, {"A": value}))
    (question,) = IndiReader("server").feed(get_properties(device, name))
    assert (vector.device, vector.name) == (question.device, question.name) == (device, name)
    assert vector.elements == (IndiElement({"name": "A"}, value.strip()),)


@pytest.mark.parametrize("text", ["", "12:30:00", "nan", "inf", "1e999", "x"])
def test_what_is_no_number_is_lost(text: str) -> None:
    with pytest.raises(LostError, match=r"EXPOSURE is '.*', which is not a number"):
        number(text, "EXPOSURE")


@given(st.text(max_size=60), st.sampled_from(["", ".fits", ".fits.z"]), st.text(max_size=4))
def test_a_damaged_frame_is_bytes_or_bad(text: str, kind: str, size: str) -> None:
    try:
        content = blob_bytes(IndiElement({"format": kind, "size": size}, text), "camera")
    except BadFrameError as error:
        said = str(error)
    else:
        said = "camera"
        assert size in ("", str(len(content)))
    assert said.startswith("camera")


def test_frames_are_unpacked_and_measured() -> None:
    packed = base64.b64encode(zlib.compress(b"counts")).decode()
    assert blob_bytes(IndiElement({"format": ".fits.z", "size": "6"}, packed), "camera") == b"counts"
    with pytest.raises(BadFrameError, match="has 6 bytes, but states a size of 7"):
        blob_bytes(IndiElement({"format": ".fits.z", "size": "7"}, packed), "camera")
    with pytest.raises(BadFrameError, match="truncated or larger"):
        blob_bytes(
            IndiElement({"format": ".fits.z"}, base64.b64encode(zlib.compress(bytes(999))[:-5]).decode()), "camera"
        )
    with pytest.raises(BadFrameError, match="cannot be decoded"):
        blob_bytes(IndiElement({"format": ".fits"}, "?"), "camera")


@pytest.mark.parametrize(
    ("address", "where"),
    [
        ("localhost:7625/CCD Simulator", ("localhost", 7625, "CCD Simulator")),
        ("pi/ZWO EFW", ("pi", 7624, "ZWO EFW")),
        ("10.0.0.2:1/A/B", ("10.0.0.2", 1, "A/B")),
        ("[::1]:7625/A", ("::1", 7625, "A")),
        ("[::1]/A", ("::1", 7624, "A")),
    ],
)
def test_addresses(address: str, where: tuple[str, int, str]) -> None:
    assert indi_address(address, "camera") == where


@pytest.mark.parametrize("address", ["pi:00000199999/A", "pi:0/A", "pi:65536/A", "pi:٣/A"])
def test_ports_that_are_none(address: str) -> None:
    with pytest.raises(RefusedError, match="is not an INDI address"):
        indi_address(address, "camera")


@given(st.one_of(st.text(), st.from_regex(r"[a-z]{0,3}:?[0-9]{0,7}/? ?[A-Z]?", fullmatch=True)))
def test_any_address_is_one_or_refused(address: str) -> None:
    try:
        where = indi_address(address, "camera")
    except RefusedError:
        return
    assert where.host
    assert where.device
    assert 0 < where.port < 65536


def test_fits_counts_and_header() -> None:
    counts = np.array([[0, 1, 32767], [32768, 65534, 65535]], dtype=np.uint16)
    image = read_fits_image(fits(counts, EXPTIME="1.000000E-01", FILTER="'it''s '", OLD="1.5D2", NONE=""), "camera")
    np.testing.assert_array_equal(image.counts, counts)
    assert image.counts.dtype == np.uint16
    assert {key: image.header.get(key) for key in ("EXPTIME", "FILTER", "OLD", "SIMPLE", "NONE")} == {
        "EXPTIME": 0.1,
        "FILTER": "it's",
        "OLD": 150.0,
        "SIMPLE": True,
        "NONE": None,
    }


def test_fits_that_is_something_else_is_refused() -> None:
    counts = np.full((2, 2), 40000, dtype=np.uint16)
    for cards in ({"BITPIX": "-32"}, {"NAXIS": "3"}, {"BSCALE": "2.0"}, {"BZERO": "7"}):
        with pytest.raises(RefusedError, match="raw image of 16-bit counts is needed"):
            read_fits_image(fits(counts, **cards), "camera")
    with pytest.raises(RefusedError, match="negative counts"):
        read_fits_image(fits(counts - np.uint16(20000), BZERO="0"), "camera")
    np.testing.assert_array_equal(read_fits_image(fits(counts, BZERO="0"), "camera").counts, counts - 32768)


def test_fits_that_is_cut_off_is_a_bad_frame() -> None:
    whole = fits(np.ones((4, 4)))
    for cut in (0, 79, BLOCK_BYTES - 2400, BLOCK_BYTES, len(whole) - 1):
        with pytest.raises(BadFrameError, match=r"is not a FITS file with a complete header|bytes after its header"):
            read_fits_image(whole[:cut], "camera")
    with pytest.raises(BadFrameError, match="0 x 4 px"):
        read_fits_image(fits(np.ones((4, 4)), NAXIS1="1E9"), "camera")


@given(st.integers(0, BLOCK_BYTES + 31), st.binary(min_size=1, max_size=90))
def test_damaged_fits_is_an_image_bad_or_refused(at: int, instead: bytes) -> None:
    whole = fits(np.ones((4, 4)))
    try:
        image = read_fits_image(whole[:at] + instead + whole[at + len(instead) :], "camera")
    except (BadFrameError, RefusedError) as error:
        said = str(error)
    else:
        said = "camera"
        assert image.counts.ndim == 2
    assert said.startswith("camera")


def test_nothing_at_the_address_is_lost_at_once() -> None:
    port = free_port()
    began_s = time.monotonic()
    with IndiClient(f"127.0.0.1:{port}/A", "camera", "B") as client, pytest.raises(LostError, match="nothing listens"):
        client.ready(began_s + 5.0)
    assert time.monotonic() - began_s < 1.0
    assert devices_at(IndiAddress("127.0.0.1", port, ""), began_s + 1.0) == {}


def test_a_closed_client_says_so() -> None:
    with IndiClient("127.0.0.1:1/A", "camera", "B") as client:
        with pytest.raises(LostError, match="the connection is closed"):
            client.enable_blobs(time.monotonic() + 1.0)
        with pytest.raises(LostError, match="the connection is closed"):
            client.drain(time.monotonic() + 1.0)


@pytest.mark.parametrize(
    ("said", "error"),
    [
        (b"", TimedOutError),
        (b"SSH-2.0-OpenSSH_9.2\r\n</x>", LostError),
        (b'<defSwitchVector device="A" name="CONNECTION" state="Alert"></defSwitchVector>', TimedOutError),
        (b'<defNumberVector device="A" name="B"><defNumber name="C" min="?" max="1"/></defNumberVector>', LostError),
        (
            b'<defNumberVector device="A" name="X"><defNumber name="C" min="nan" max="inf"/></defNumberVector>',
            TimedOutError,
        ),
    ],
)
def test_a_stranger_at_the_port_is_found_out_in_time(said: bytes, error: type[Exception]) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        accepted: list[socket.socket] = []

        def serve() -> None:
            connection, _ = server.accept()
            accepted.append(connection)
            connection.sendall(said)

        thread = threading.Thread(target=serve)
        thread.start()
        began_s = time.monotonic()
        with IndiClient(f"127.0.0.1:{server.getsockname()[1]}/A", "camera", "B") as client, pytest.raises(error):
            client.ready(began_s + 0.5)
        # One second more than allowed, for a machine that is busy.
        assert time.monotonic() - began_s < 1.5
        thread.join()
        for connection in accepted:
            connection.close()


def test_a_server_that_talks_without_end_is_late() -> None:
    """Every message comes in time, the one that is waited for never does."""
    stop = threading.Event()
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve() -> None:
            connection, _ = server.accept()
            with connection, contextlib.suppress(OSError):
                while not stop.is_set():
                    connection.sendall(b'<message device="other" message="still here"/>' * 1000)

        thread = threading.Thread(target=serve)
        thread.start()
        try:
            began_s = time.monotonic()
            with (
                IndiClient(f"127.0.0.1:{server.getsockname()[1]}/A", "camera", "B") as client,
                pytest.raises(TimedOutError, match="the server does not report this device"),
            ):
                client.ready(began_s + 0.5)
            # One second more than allowed, for a machine that is busy.
            assert time.monotonic() - began_s < 1.5
        finally:
            stop.set()
            thread.join()


def test_a_server_that_says_monstrous_numbers_is_listed() -> None:
    kinds = b"9" * 5000
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve() -> None:
            connection, _ = server.accept()
            with connection:
                connection.sendall(
                    b'<defTextVector device="A" name="DRIVER_INFO"><defText name="DRIVER_INTERFACE">'
                    + kinds
                    + b"</defText></defTextVector>"
                )

        thread = threading.Thread(target=serve)
        thread.start()
        assert devices_at(IndiAddress("127.0.0.1", server.getsockname()[1], ""), time.monotonic() + 1.0) == {"A": 0}
        thread.join()


@pytest.mark.parametrize("host", ["a..b", "x" * 64])
def test_a_name_that_no_host_has_is_lost(host: str) -> None:
    with IndiClient(f"{host}:1/A", "camera", "B") as client, pytest.raises(LostError, match="nothing listens at"):
        client.ready(time.monotonic() + 1.0)


def test_the_address_is_checked_before_anything_is_opened() -> None:
    with (
        pytest.raises(RefusedError, match="laser: 'nonsense' is not an INDI address"),
        open_switch("nonsense", "laser", None),
    ):
        pass


def gain(kind: str, value: int) -> bytes:
    return (
        f'<{kind}NumberVector device="A" name="GAIN" state="Ok"><{"def" if kind == "def" else "one"}Number '
        f'name="GAIN_VALUE" min="0" max="100">{value}</{"def" if kind == "def" else "one"}Number></{kind}NumberVector>'
    ).encode()


@pytest.mark.parametrize("answer", [gain("def", 7), gain("def", 7) + gain("set", 7)])
def test_a_property_that_the_driver_defines_anew_meanwhile_is_changed_and_read_back(answer: bytes) -> None:
    """Drivers that rebuild their controls withdraw a property and define it again, instead of setting it."""
    connection = b'<defSwitchVector device="A" name="CONNECTION"><defSwitch name="CONNECT">On</defSwitch>'
    connected = connection + b"</defSwitchVector>"
    withdrawn = b'<delProperty device="A" name="GAIN"/>'
    change = new_vector("Number", "A", "GAIN", {"GAIN_VALUE": "7"})
    spoken = [
        ("host", get_properties("A")),
        ("device", connected + gain("def", 3) + b'<defTextVector device="A" name="B"/>'),
        ("host", get_properties("A", "CONNECTION")),
        ("device", connected),
        ("host", change),
        ("device", withdrawn + answer),
        ("host", get_properties("A", "GAIN")),
        ("device", withdrawn + gain("def", 7)),
    ]
    with (
        replayed(spoken) as address,
        IndiClient(f"{address.removeprefix('socket://')}/A", "camera", "B") as client,
    ):
        end_s = time.monotonic() + 1.0
        client.ready(end_s)
        known = client.change("Number", "GAIN", {"GAIN_VALUE": "7"}, end_s)
        assert (known.values, known.state) == ({"GAIN_VALUE": "7"}, "Ok")
