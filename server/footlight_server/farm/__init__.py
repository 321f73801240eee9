"""The farm queue: durable jobs, and what drives their tasks through the workers."""
