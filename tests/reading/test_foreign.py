"""MCAP files of other programs: protobuf is given as it is, anything else is listed."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import mcapfiles as files
import pytest
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from google.protobuf import descriptor_pb2, struct_pb2
from mcap.writer import Writer
from mcapfiles import T0

from roclog.recording.protobuf import MAX_SCHEMA, MessageReader, UndecodableError
from roclog.recording.reader import open_recording

if TYPE_CHECKING:
    from pathlib import Path


def write(path: Path, topics: list[files.Topic], items: list[files.Item], **options: Any) -> Path:
    return files.write_sealed(
        path, items, topics=topics, metadata={}, library="somebody else", **options
    )


@pytest.mark.parametrize("use_chunking", [True, False])
def test_nested_messages(tmp_path: Path, use_chunking: bool) -> None:
    pose = PoseInFrame(frame_id="map")
    pose.timestamp.seconds = 5
    pose.pose.position.x = 1.5
    item = files.Item("/a/b/c", T0, pose.SerializeToString(), 77, T0 + 1)
    topics = [files.Topic("/a/b/c", PoseInFrame)]
    path = write(tmp_path / "x.mcap", topics, [item], use_chunking=use_chunking)
    (sample,) = open_recording(path)
    assert (sample.device, sample.block, sample.seq, sample.epoch) == ("a", "b/c", 77, b"")
    assert (sample.asked_at, sample.read_at, sample.raw) == (None, None, b"")
    assert sample.values["timestamp"] == 5 * 10**9
    assert sample.values["frame_id"] == "map"
    assert sample.values["pose"] == {
        "position": {"x": 1.5, "y": 0.0, "z": 0.0},
        "orientation": None,
    }


def test_maps_lists_and_recursion(tmp_path: Path) -> None:
    struct = struct_pb2.Struct()
    struct.update({"list": [1, {"deep": True}], "text": "x"})
    item = files.Item("/s", T0, struct.SerializeToString())
    path = write(tmp_path / "x.mcap", [files.Topic("/s", struct_pb2.Struct)], [item])
    (sample,) = open_recording(path)
    fields: Any = sample.values["fields"]
    assert fields["text"]["string_value"] == "x"
    assert fields["list"]["list_value"]["values"][0]["number_value"] == 1.0


def test_equal_messages_of_others_are_no_copies(tmp_path: Path) -> None:
    item = files.Item("/log", T0, Log(message="x").SerializeToString())
    path = write(tmp_path / "x.mcap", [files.Topic("/log", Log)], [item, item])
    assert len(list(open_recording(path).events())) == 2


def test_a_channel_that_is_not_protobuf_is_listed(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    with path.open("wb") as file:
        writer: Any = Writer(file)
        writer.start()
        schema = writer.register_schema("Thing", "jsonschema", b'{"type": "object"}')
        channel = writer.register_channel("/thing", "json", schema)
        bare = writer.register_channel("/bare", "json", 0)
        writer.add_message(channel, T0, b"{}", T0)
        writer.add_message(bare, T0, b"{}", T0)
        writer.finish()
    recording = open_recording(path)
    assert list(recording.records()) == []
    assert "json" in recording.channels["/thing"].problem
    assert "no schema" in recording.channels["/bare"].problem
    assert recording.damage == []


def bad_schemas() -> dict[str, bytes]:
    made = descriptor_pb2.FileDescriptorSet()
    circle = made.file.add(name="a.proto", package="x", dependency=["b.proto"])
    circle.message_type.add(name="A")
    made.file.add(name="b.proto", dependency=["a.proto"])
    missing = descriptor_pb2.FileDescriptorSet()
    missing.file.add(name="a.proto", package="x", dependency=["gone.proto"])
    method = descriptor_pb2.FileDescriptorSet()
    method.file.add(name="a.proto", package="x").message_type.add(name="A").field.add(
        name="HasField", number=1, type=8, label=1
    )
    deep = b""
    for _ in range(5000):
        deep = b"\x1a" + len(deep).to_bytes(3, "little") + deep
    twice = descriptor_pb2.FileDescriptorSet()
    for name in ("a.proto", "b.proto"):
        twice.file.add(name=name, package="x").message_type.add(name="A")
    return {
        "garbage": b"\xff" * 50,
        "empty": b"",
        "circle": made.SerializeToString(),
        "missing dependency": missing.SerializeToString(),
        "field named like a method": method.SerializeToString(),
        "nested too deep": deep,
        "too long": bytes(MAX_SCHEMA + 1),
        "defined twice": twice.SerializeToString(),
    }


@pytest.mark.parametrize("name", bad_schemas())
def test_hostile_schemas(tmp_path: Path, name: str) -> None:
    data = bad_schemas()[name]
    with pytest.raises(UndecodableError):
        MessageReader("x.A", data)
    topics = [files.Topic("/bad", files.SAMPLE, schema=data), *files.TOPICS]
    items = [files.Item("/bad", T0, b"x"), files.sample(1)]
    recording = open_recording(files.write_sealed(tmp_path / "x.mcap", items, topics=topics))
    assert [sample.seq for sample in recording] == [1]
    assert recording.channels["/bad"].problem
    assert "/bad" in str(recording.damage[0])


def test_a_message_that_would_become_a_million_objects(tmp_path: Path) -> None:
    item = files.Item("/s", T0, b"\x0a\x00" * 2**20)
    path = write(tmp_path / "x.mcap", [files.Topic("/s", struct_pb2.ListValue)], [item])
    recording = open_recording(path)
    assert list(recording) == []
    assert "more than" in str(recording.damage[0])


def test_a_type_called_like_ours_with_other_fields(tmp_path: Path) -> None:
    odd = files.message_class("roclog.Gap", "from 1 double, to 2 string")
    items = [files.Item("/x/gap", T0, odd(to="later").SerializeToString())]
    recording = open_recording(write(tmp_path / "x.mcap", [files.Topic("/x/gap", odd)], items))
    (sample,) = recording
    assert sample.values == {"from": 0.0, "to": "later"}
    assert list(recording.gaps()) == []
