"""The Footlight service: renders USD stages, streams tiles while they converge."""
