"""Renders as the server sees them: states, queue, what viewers are owed."""
