"""What the tests of the barrier contact use; a test module that imports this is skipped where its library is not."""

import pytest

from sim.mechanics._contact_library import contact_library_failure

if contact_library_failure() is not None:
    pytest.skip(f"NO BARRIER CONTACT: {contact_library_failure()}", allow_module_level=True)

from sim.mechanics._barrier_contact import Barrier, BarrierContact, DrivenContact
from sim.mechanics._colliding_surfaces import Obstacle

__all__ = ["Barrier", "BarrierContact", "DrivenContact", "Obstacle"]
