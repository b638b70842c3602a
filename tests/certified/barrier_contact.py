"""What the tests of the barrier contact use; a test module that imports this is skipped where its library is not."""

import pytest

from sim.mechanics.contact_library import contact_library_failure

if contact_library_failure() is not None:
    pytest.skip(f"NO BARRIER CONTACT: {contact_library_failure()}", allow_module_level=True)

from sim.mechanics.colliding_surfaces import Obstacle
from sim.mechanics.contact_ipc import Barrier, BarrierContact
from sim.mechanics.driven_contact import DrivenContact

__all__ = ["Barrier", "BarrierContact", "DrivenContact", "Obstacle"]
