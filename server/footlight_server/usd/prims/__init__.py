"""One file per kind of prim: from a prim to calls on the sink."""
