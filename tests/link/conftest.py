"""Settings of the tests of the wire."""

from hypothesis import settings

settings.register_profile("link", deadline=None)
settings.load_profile("link")
