"""Frame tokens in file names, and names as people type them."""

import pytest

from footlight.names import (
    attempt_or_task_name,
    job_name,
    job_of,
    job_or_task_name,
    number_of,
    short,
    task_name,
    token_name,
)
from footlight.sequence import frame_path, has_frame


@pytest.mark.parametrize(
    ("pattern", "frame", "name"),
    [
        ("a.####.exr", 7, "a.0007.exr"),
        ("a.####.exr", 12345, "a.12345.exr"),
        ("a.####.exr", -7, "a.-007.exr"),
        ("a.#.exr", 7, "a.7.exr"),
        ("a.$F4.exr", 7, "a.0007.exr"),
        ("a.$F.exr", 7, "a.7.exr"),
        ("<layer>/a.<frame>.exr", 7, "beauty/a.7.exr"),
        ("a.exr", 7, "a.exr"),
    ],
)
def test_a_token_becomes_the_number(pattern: str, frame: int, name: str) -> None:
    assert frame_path(pattern, frame, "beauty") == name
    assert has_frame(pattern) == (pattern != "a.exr")


def test_names_are_taken_as_people_type_them() -> None:
    assert {job_name(text) for text in ("12", 12, "jobs/12", "012")} == {"jobs/12"}
    assert {task_name(text) for text in ("12/3", "jobs/12/tasks/3", "jobs/12/3")} == {"jobs/12/tasks/3"}
    assert attempt_or_task_name("12/3/1") == attempt_or_task_name("jobs/12/tasks/3/attempts/1")
    assert attempt_or_task_name("12/3") == job_or_task_name("12/3") == "jobs/12/tasks/3"
    assert job_or_task_name("12") == "jobs/12"
    assert token_name("3") == token_name("tokens/3") == "tokens/3"
    assert short("jobs/12/tasks/3/attempts/1") == "12/3/1"
    assert job_of("jobs/12/tasks/3") == job_of("jobs/12") == "jobs/12"
    assert number_of("jobs/12/tasks/3") == 3


@pytest.mark.parametrize("text", ["", "x", "-1", "1.5", "jobs/", "jobs/x", "tasks/3", "12/3/1/9", "1 2", "12\n"])
def test_what_is_no_name_is_refused(text: str) -> None:
    for form in (job_name, task_name, job_or_task_name, attempt_or_task_name):
        with pytest.raises(ValueError, match=r"write 12|neither a job"):
            form(text)
