"""Worker processes: where pxr and the core load, and how the server holds on to them."""
