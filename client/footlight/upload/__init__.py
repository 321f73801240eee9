"""Uploads: a stage with all it refers to, sent to a server as files by content."""
