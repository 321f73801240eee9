"""A job from plain values: every field can be said, what is not said is the server's, what cannot be is refused."""

from pathlib import Path

import pytest

from footlight import Client, job_spec, layer_spec, render_spec
from footlight.errors import JobCancelledError, JobFailedError
from footlight.job_calls import job_state, outcome, task_state
from footlight.v1 import job_pb2


def test_every_field_of_the_messages_can_be_set() -> None:
    layer = layer_spec(
        render_spec("/a.usda"),
        name="beauty",
        frames="1-10x2",
        output="a.####.exr",
        chunk=2,
        split=1,
        after=["sim"],
        after_frames_of=["volume"],
        limits=["houdini"],
    )
    spec = job_spec(
        layer,
        title="t",
        show="s",
        shot="h",
        priority=0,
        tags=["x"],
        comment="c",
        depends=["jobs/1"],
        retries=0,
        timeout_seconds=1.5,
        stall_timeout_seconds=2.5,
        paused=True,
        environment={"A": "b"},
    )
    for message in (spec, layer):
        assert {field.name for field, _ in message.ListFields()} == {field.name for field in message.DESCRIPTOR.fields}
    assert spec.HasField("priority")
    assert layer.output == str(Path.cwd() / "a.####.exr")
    assert [(other.layer, other.frame_by_frame) for other in layer.depends] == [("sim", False), ("volume", True)]


def test_what_is_not_said_is_left_to_the_server() -> None:
    assert job_spec() == job_pb2.JobSpec()
    assert [field.name for field, _ in layer_spec(render_spec("/a.usda")).ListFields()] == ["render"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"priority": -1}, "priority: -1"),
        ({"retries": 2**40}, "retries: "),
        ({"timeout_seconds": "x"}, "timeout_seconds: x"),
    ],
)
def test_what_a_message_cannot_hold_is_refused_by_name(options: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        job_spec(**options)


def test_states_are_words() -> None:
    assert job_state("running") == job_pb2.JOB_STATE_RUNNING
    assert task_state("skipped") == job_pb2.TASK_STATE_SKIPPED
    for form in (job_state, task_state):
        with pytest.raises(ValueError, match=r"'asleep' is not one of .*running"):
            form("asleep")
        with pytest.raises(ValueError, match="unspecified"):
            form("unspecified")


def test_an_end_that_is_no_success_is_an_error() -> None:
    job = job_pb2.Job(state=job_pb2.JOB_STATE_SUCCEEDED)
    assert outcome(job) is job
    with pytest.raises(JobFailedError):
        outcome(job_pb2.Job(state=job_pb2.JOB_STATE_FAILED))
    with pytest.raises(JobCancelledError):
        outcome(job_pb2.Job(state=job_pb2.JOB_STATE_CANCELLED))


def test_unknown_names_are_refused_with_the_known_ones() -> None:
    with Client("127.0.0.1:1") as client:
        with pytest.raises(ValueError, match="image_format: 'tiff' is not one of exr, thumbnail, contact-sheet, png"):
            client.farm.job(1).image(1, image_format="tiff")  # type: ignore[arg-type]
        with pytest.raises(ValueError, match="image_format: 'tiff' is not one of exr, png"):
            client.session("renders/1").result("tiff")  # type: ignore[arg-type]
        with pytest.raises(ValueError, match="scope: 'all' is not one of read, submit, admin"):
            client.tokens.create("anna", "all")  # type: ignore[arg-type]
