"""`footlight submit`: from options to a job, and perhaps to its end."""

import sys

from footlight.cli import parse
from footlight.cli.commands.submit import JobOptions
from footlight.cli.connect import connect, path_map
from footlight.cli.options import MappedConnection, RenderOptions
from footlight.cli.report import note, usage
from footlight.cli.stage import place
from footlight.cli.tables import write_json, write_json_line
from footlight.cli.watch import run_watch
from footlight.names import short
from footlight.paths import PathMap
from footlight.plain import plain
from footlight.spec import render_spec
from footlight.submission import job_spec, layer_spec
from footlight.v1 import job_pb2


def run_submit(
    connection: MappedConnection,
    options: RenderOptions,
    job: JobOptions,
    *,
    upload: bool,
    dry_run: bool,
    watch: bool,
    as_json: bool,
) -> None:
    """Submit, say what came of it, and watch it if that is asked for."""
    with usage():
        paths = path_map(connection)
        spec = make_spec(options, job, paths)
    with connect(connection) as client:
        place(client, spec.layers[0].render, options.stage, paths, upload=upload)
        answer = client.farm.create(spec, dry_run=dry_run)
    if as_json and watch:
        write_json_line(plain(answer))
    elif as_json:
        write_json(plain(answer))
    elif dry_run:
        sys.stdout.writelines(f"{line}\n" for line in answer.notes)
    else:
        sys.stdout.write(f"{answer.job.name}\n")
        sys.stdout.flush()
        for line in answer.notes:
            note(line)
    if watch and not dry_run:
        run_watch(connection, answer.job.name, tev="", after=0, as_json=as_json)
    elif not (dry_run or as_json):
        note(f"`footlight watch {short(answer.job.name)}` shows how far it is")


def make_spec(options: RenderOptions, job: JobOptions, paths: PathMap) -> job_pb2.JobSpec:
    """The job, its stage not placed yet. Raises ValueError naming a field, typer.BadParameter naming an option."""
    layer = layer_spec(
        render_spec(**options.arguments(), png=job.png),
        name=job.layer,
        frames=job.frames,
        output=paths.to_server(job.output) if job.output else "",
        chunk=job.chunk,
        split=job.split,
        limits=job.limit or (),
    )
    return job_spec(
        layer,
        title=job.name,
        show=job.show,
        shot=job.shot,
        priority=job.priority,
        tags=job.tag or (),
        comment=job.comment,
        depends=parse.jobs(job.depends or (), "--depends"),
        retries=job.retries,
        timeout_seconds=parse.duration(job.timeout, "--timeout"),
        stall_timeout_seconds=parse.duration(job.stall_timeout, "--stall-timeout"),
        paused=job.paused,
        environment=parse.environment(job.env or ()),
    )
