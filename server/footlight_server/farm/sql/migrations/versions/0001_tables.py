"""The tables of the first queue."""

import sqlalchemy as sa
from alembic import op

revision = "0001"
down_revision = None
branch_labels = None
depends_on = None


def upgrade() -> None:
    """To this revision."""
    op.create_table(
        "job",
        sa.Column("number", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), nullable=False),
        sa.Column("title", sa.Text(), nullable=False),
        sa.Column("user", sa.Text(), nullable=False),
        sa.Column("state", sa.Text(), nullable=False),
        sa.Column("paused", sa.Boolean(), nullable=False),
        sa.Column("cancelling", sa.Boolean(), server_default=sa.text("false"), nullable=False),
        sa.Column("priority", sa.Integer(), nullable=False),
        sa.Column("retries", sa.Integer(), nullable=False),
        sa.Column("show", sa.Text(), server_default="", nullable=False),
        sa.Column("shot", sa.Text(), server_default="", nullable=False),
        sa.Column("request_id", sa.Text(), server_default="", nullable=False),
        sa.Column("created", sa.Double(), nullable=False),
        sa.Column("started", sa.Double(), nullable=True),
        sa.Column("ended", sa.Double(), nullable=True),
        sa.Column("unmet", sa.Integer(), server_default=sa.text("0"), nullable=False),
        sa.Column("blocked", sa.Integer(), server_default=sa.text("0"), nullable=False),
        sa.Column("ready", sa.Integer(), server_default=sa.text("0"), nullable=False),
        sa.Column("running", sa.Integer(), server_default=sa.text("0"), nullable=False),
        sa.Column("succeeded", sa.Integer(), server_default=sa.text("0"), nullable=False),
        sa.Column("failed", sa.Integer(), server_default=sa.text("0"), nullable=False),
        sa.Column("skipped", sa.Integer(), server_default=sa.text("0"), nullable=False),
        sa.Column("cancelled", sa.Integer(), server_default=sa.text("0"), nullable=False),
        sa.Column("frames_done", sa.Integer(), server_default=sa.text("0"), nullable=False),
        sa.Column("frames_total", sa.Integer(), server_default=sa.text("0"), nullable=False),
        sa.Column("render_seconds", sa.Double(), server_default=sa.text("0"), nullable=False),
        sa.PrimaryKeyConstraint("number", name=op.f("pk_job")),
        sqlite_autoincrement=True,
    )
    op.create_index(
        "ix_job_claim",
        "job",
        [sa.literal_column("priority DESC"), "number"],
        unique=False,
        sqlite_where=sa.text("ready > 0 AND NOT paused"),
        postgresql_where=sa.text("ready > 0 AND NOT paused"),
    )
    op.create_index(
        "ix_job_open",
        "job",
        ["user"],
        unique=False,
        sqlite_where=sa.text("ended IS NULL"),
        postgresql_where=sa.text("ended IS NULL"),
    )
    op.create_index(
        "ix_job_request",
        "job",
        ["user", "request_id"],
        unique=True,
        sqlite_where=sa.text("request_id <> ''"),
        postgresql_where=sa.text("request_id <> ''"),
    )

    op.create_table(
        "limit",
        sa.Column("name", sa.Text(), nullable=False),
        sa.Column("most", sa.BigInteger(), nullable=False),
        sa.Column("unit", sa.Text(), nullable=False),
        sa.PrimaryKeyConstraint("name", name=op.f("pk_limit")),
    )
    op.create_table(
        "token",
        sa.Column("number", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), nullable=False),
        sa.Column("hash", sa.Text(), nullable=False),
        sa.Column("user", sa.Text(), nullable=False),
        sa.Column("scope", sa.Text(), nullable=False),
        sa.Column("comment", sa.Text(), server_default="", nullable=False),
        sa.Column("created", sa.Double(), nullable=False),
        sa.Column("expires", sa.Double(), nullable=True),
        sa.Column("revoked", sa.Double(), nullable=True),
        sa.Column("last_used", sa.Double(), nullable=True),
        sa.PrimaryKeyConstraint("number", name=op.f("pk_token")),
        sa.UniqueConstraint("hash", name=op.f("uq_token_hash")),
        sqlite_autoincrement=True,
    )
    op.create_table(
        "attempt",
        sa.Column("job", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), nullable=False),
        sa.Column("task", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("number", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("worker", sa.Text(), nullable=False),
        sa.Column("host", sa.Text(), nullable=False),
        sa.Column("started", sa.Double(), nullable=False),
        sa.Column("ended", sa.Double(), nullable=True),
        sa.Column("exit_class", sa.Text(), nullable=True),
        sa.Column("message", sa.Text(), server_default="", nullable=False),
        sa.Column("prim_path", sa.Text(), server_default="", nullable=False),
        sa.Column("peak_memory_bytes", sa.BigInteger(), server_default=sa.text("0"), nullable=False),
        sa.ForeignKeyConstraint(["job"], ["job.number"], name=op.f("fk_attempt_job"), ondelete="CASCADE"),
        sa.PrimaryKeyConstraint("job", "task", "number", name=op.f("pk_attempt")),
        sqlite_with_rowid=False,
    )
    op.create_index(
        "ix_attempt_running",
        "attempt",
        ["job", "task"],
        unique=False,
        sqlite_where=sa.text("ended IS NULL"),
        postgresql_where=sa.text("ended IS NULL"),
    )

    op.create_table(
        "event",
        sa.Column("id", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), nullable=False),
        sa.Column("time", sa.Double(), nullable=False),
        sa.Column("job", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), nullable=False),
        sa.Column("kind", sa.Text(), nullable=False),
        sa.Column("task", sa.Integer(), nullable=True),
        sa.Column("layer", sa.Text(), server_default="", nullable=False),
        sa.Column("frame", sa.Integer(), nullable=True),
        sa.Column("state", sa.Text(), server_default="", nullable=False),
        sa.ForeignKeyConstraint(["job"], ["job.number"], name=op.f("fk_event_job"), ondelete="CASCADE"),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_event")),
        sqlite_autoincrement=True,
    )
    op.create_index(op.f("ix_event_job_id"), "event", ["job", "id"], unique=False)

    op.create_table(
        "frame",
        sa.Column("job", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), nullable=False),
        sa.Column("task", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("frame", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("part", sa.Boolean(), nullable=False),
        sa.Column("layer", sa.Text().with_variant(sa.Text(collation="C"), "postgresql"), nullable=False),
        sa.Column("path", sa.Text(), nullable=False),
        sa.Column("sha256", sa.Text(), nullable=False),
        sa.Column("size_bytes", sa.BigInteger(), nullable=False),
        sa.Column("attempt", sa.Integer(), nullable=False),
        sa.Column("stats", sa.LargeBinary(), nullable=False),
        sa.ForeignKeyConstraint(["job"], ["job.number"], name=op.f("fk_frame_job"), ondelete="CASCADE"),
        sa.PrimaryKeyConstraint("job", "task", "frame", name=op.f("pk_frame")),
    )
    op.create_index(
        "ix_frame_image",
        "frame",
        ["job", "layer", "frame"],
        unique=True,
        sqlite_where=sa.text("NOT part"),
        postgresql_where=sa.text("NOT part"),
    )

    op.create_table(
        "job_bundle",
        sa.Column("job", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), nullable=False),
        sa.Column("digest", sa.Text(), nullable=False),
        sa.ForeignKeyConstraint(["job"], ["job.number"], name=op.f("fk_job_bundle_job"), ondelete="CASCADE"),
        sa.PrimaryKeyConstraint("job", "digest", name=op.f("pk_job_bundle")),
    )
    op.create_table(
        "job_need",
        sa.Column("job", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), nullable=False),
        sa.Column("needs", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), nullable=False),
        sa.ForeignKeyConstraint(["job"], ["job.number"], name=op.f("fk_job_need_job"), ondelete="CASCADE"),
        sa.PrimaryKeyConstraint("job", "needs", name=op.f("pk_job_need")),
    )
    op.create_index(op.f("ix_job_need_needs"), "job_need", ["needs"], unique=False)

    op.create_table(
        "job_spec",
        sa.Column("job", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), nullable=False),
        sa.Column("spec", sa.LargeBinary(), nullable=False),
        sa.ForeignKeyConstraint(["job"], ["job.number"], name=op.f("fk_job_spec_job"), ondelete="CASCADE"),
        sa.PrimaryKeyConstraint("job", name=op.f("pk_job_spec")),
    )
    op.create_table(
        "job_tag",
        sa.Column("job", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), nullable=False),
        sa.Column("tag", sa.Text(), nullable=False),
        sa.ForeignKeyConstraint(["job"], ["job.number"], name=op.f("fk_job_tag_job"), ondelete="CASCADE"),
        sa.PrimaryKeyConstraint("job", "tag", name=op.f("pk_job_tag")),
    )
    op.create_index(op.f("ix_job_tag_tag"), "job_tag", ["tag"], unique=False)

    op.create_table(
        "lane_blame",
        sa.Column("job", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), nullable=False),
        sa.Column("lane", sa.Text(), nullable=False),
        sa.Column("tasks", sa.Integer(), nullable=False),
        sa.ForeignKeyConstraint(["job"], ["job.number"], name=op.f("fk_lane_blame_job"), ondelete="CASCADE"),
        sa.PrimaryKeyConstraint("job", "lane", name=op.f("pk_lane_blame")),
    )
    op.create_index(op.f("ix_lane_blame_lane"), "lane_blame", ["lane"], unique=False)

    op.create_table(
        "lane_failure",
        sa.Column("job", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), nullable=False),
        sa.Column("task", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("lane", sa.Text(), nullable=False),
        sa.ForeignKeyConstraint(["job"], ["job.number"], name=op.f("fk_lane_failure_job"), ondelete="CASCADE"),
        sa.PrimaryKeyConstraint("job", "task", "lane", name=op.f("pk_lane_failure")),
    )
    op.create_table(
        "layer",
        sa.Column("job", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), nullable=False),
        sa.Column("number", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("name", sa.Text().with_variant(sa.Text(collation="C"), "postgresql"), nullable=False),
        sa.Column("total", sa.Integer(), nullable=False),
        sa.Column("tasks_left", sa.Integer(), nullable=False),
        sa.Column("unmet", sa.Integer(), server_default=sa.text("0"), nullable=False),
        sa.ForeignKeyConstraint(["job"], ["job.number"], name=op.f("fk_layer_job"), ondelete="CASCADE"),
        sa.PrimaryKeyConstraint("job", "number", name=op.f("pk_layer")),
    )
    op.create_table(
        "layer_limit",
        sa.Column("job", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), nullable=False),
        sa.Column("layer", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("name", sa.Text(), nullable=False),
        sa.ForeignKeyConstraint(["job"], ["job.number"], name=op.f("fk_layer_limit_job"), ondelete="CASCADE"),
        sa.PrimaryKeyConstraint("job", "layer", "name", name=op.f("pk_layer_limit")),
    )
    op.create_table(
        "layer_need",
        sa.Column("job", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), nullable=False),
        sa.Column("layer", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("needs", sa.Integer(), autoincrement=False, nullable=False),
        sa.ForeignKeyConstraint(["job"], ["job.number"], name=op.f("fk_layer_need_job"), ondelete="CASCADE"),
        sa.PrimaryKeyConstraint("job", "layer", "needs", name=op.f("pk_layer_need")),
    )
    op.create_table(
        "layer_spec",
        sa.Column("job", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), nullable=False),
        sa.Column("layer", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("spec", sa.LargeBinary(), nullable=False),
        sa.ForeignKeyConstraint(["job"], ["job.number"], name=op.f("fk_layer_spec_job"), ondelete="CASCADE"),
        sa.PrimaryKeyConstraint("job", "layer", name=op.f("pk_layer_spec")),
    )
    op.create_table(
        "staged_frame",
        sa.Column("job", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), nullable=False),
        sa.Column("task", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("frame", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("layer", sa.Text().with_variant(sa.Text(collation="C"), "postgresql"), nullable=False),
        sa.Column("path", sa.Text(), nullable=False),
        sa.Column("sha256", sa.Text(), nullable=False),
        sa.Column("size_bytes", sa.BigInteger(), nullable=False),
        sa.Column("attempt", sa.Integer(), nullable=False),
        sa.Column("stats", sa.LargeBinary(), nullable=False),
        sa.Column("temp_path", sa.Text(), nullable=False),
        sa.ForeignKeyConstraint(["job"], ["job.number"], name=op.f("fk_staged_frame_job"), ondelete="CASCADE"),
        sa.PrimaryKeyConstraint("job", "task", "frame", name=op.f("pk_staged_frame")),
    )
    op.create_table(
        "task",
        sa.Column("job", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), nullable=False),
        sa.Column("number", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("layer", sa.Integer(), nullable=False),
        sa.Column("kind", sa.Text(), nullable=False),
        sa.Column("part", sa.Boolean(), nullable=False),
        sa.Column("frames", sa.Text(), nullable=False),
        sa.Column("sample_begin", sa.BigInteger(), nullable=False),
        sa.Column("sample_end", sa.BigInteger(), nullable=False),
        sa.Column("state", sa.Text(), nullable=False),
        sa.Column("unmet", sa.Integer(), server_default=sa.text("0"), nullable=False),
        sa.Column("failures", sa.Integer(), server_default=sa.text("0"), nullable=False),
        sa.Column("losses", sa.Integer(), server_default=sa.text("0"), nullable=False),
        sa.Column("attempt", sa.Integer(), server_default=sa.text("0"), nullable=False),
        sa.Column("not_before", sa.Double(), server_default=sa.text("0"), nullable=False),
        sa.Column("stop", sa.Text(), server_default="", nullable=False),
        sa.Column("frames_done", sa.Integer(), server_default=sa.text("0"), nullable=False),
        sa.ForeignKeyConstraint(["job"], ["job.number"], name=op.f("fk_task_job"), ondelete="CASCADE"),
        sa.PrimaryKeyConstraint("job", "number", name=op.f("pk_task")),
    )
    op.create_index(
        "ix_task_claim",
        "task",
        ["job", "layer", "number", "not_before"],
        unique=False,
        sqlite_where=sa.text("state = 'ready'"),
        postgresql_where=sa.text("state = 'ready'"),
    )
    op.create_index(
        "ix_task_delayed",
        "task",
        ["not_before"],
        unique=False,
        sqlite_where=sa.text("state = 'ready' AND not_before > 0"),
        postgresql_where=sa.text("state = 'ready' AND not_before > 0"),
    )
    op.create_index(op.f("ix_task_job_state_number"), "task", ["job", "state", "number"], unique=False)

    op.create_table(
        "task_need",
        sa.Column("job", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), nullable=False),
        sa.Column("task", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("needs", sa.Integer(), autoincrement=False, nullable=False),
        sa.ForeignKeyConstraint(["job"], ["job.number"], name=op.f("fk_task_need_job"), ondelete="CASCADE"),
        sa.PrimaryKeyConstraint("job", "task", "needs", name=op.f("pk_task_need")),
        sqlite_with_rowid=False,
    )
    op.create_index(op.f("ix_task_need_job_needs"), "task_need", ["job", "needs"], unique=False)


def downgrade() -> None:
    """Back to nothing; indices go with their tables."""
    op.drop_table("task_need")
    op.drop_table("task")
    op.drop_table("staged_frame")
    op.drop_table("layer_spec")
    op.drop_table("layer_need")
    op.drop_table("layer_limit")
    op.drop_table("layer")
    op.drop_table("lane_failure")
    op.drop_table("lane_blame")
    op.drop_table("job_tag")
    op.drop_table("job_spec")
    op.drop_table("job_need")
    op.drop_table("job_bundle")
    op.drop_table("frame")
    op.drop_table("event")
    op.drop_table("attempt")
    op.drop_table("token")
    op.drop_table("limit")
    op.drop_table("job")
