"""Fixtures that the tests of this folder share."""

from tests.support.docs import desk as desk
