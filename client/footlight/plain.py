"""Messages as plain values, for JSON: numbers stay numbers, times are RFC 3339, a field at its default is there."""

from collections.abc import Mapping
from typing import Any

from google.protobuf.descriptor import FieldDescriptor  # type: ignore[import-untyped]
from google.protobuf.duration_pb2 import Duration
from google.protobuf.message import Message  # type: ignore[import-untyped]
from google.protobuf.timestamp_pb2 import Timestamp

Plain = str | int | float | bool | None | list["Plain"] | dict[str, "Plain"]


def plain(message: Message) -> dict[str, Plain]:
    """`message` as a dict by the .proto's names; enums by name, an unset optional field as None."""
    return {field.name: _field(message, field) for field in message.DESCRIPTOR.fields}


def _field(message: Message, field: FieldDescriptor) -> Plain:
    value: Any = getattr(message, field.name)
    if isinstance(value, Mapping):
        return {str(key): _single(field.message_type.fields_by_name["value"], value[key]) for key in sorted(value)}
    if field.is_repeated:
        return [_single(field, item) for item in value]
    if field.has_presence and not message.HasField(field.name):
        return None
    return _single(field, value)


def _single(field: FieldDescriptor, value: Any) -> Plain:
    if isinstance(value, Timestamp):
        time: str = value.ToJsonString()
        return time
    if isinstance(value, Duration):
        seconds: float = value.seconds + value.nanos * 1e-9
        return seconds
    if field.message_type is not None:
        return plain(value)
    if field.enum_type is not None:
        name: str = field.enum_type.values_by_number[value].name
        return name
    result: Plain = value
    return result
