"""The commands and their options; what they do is in modules loaded when a command runs, so that --help is quick."""
