"""The ground: records that pass between stages, their units, storage and errors."""
