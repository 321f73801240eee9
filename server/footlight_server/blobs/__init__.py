"""Uploads: files by content, and bundles of files that a stage consists of."""
