"""How hypothesis runs here: the machine may be busy, so a slow example is no failure."""

from hypothesis import settings

settings.register_profile("server", deadline=None)
settings.load_profile("server")
