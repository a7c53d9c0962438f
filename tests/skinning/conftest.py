"""Fixtures that the tests of this folder share."""

from tests.support.skin_fit import result as result
