"""Fixtures that the tests of this folder share."""

from tests.support.usd_example_poses import clip as clip
from tests.support.usd_stream import in_small_blocks as in_small_blocks
