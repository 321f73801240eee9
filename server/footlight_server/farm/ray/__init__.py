"""Workers on the nodes of a Ray cluster. Ray carries messages and starts processes; the queue stays the truth."""
