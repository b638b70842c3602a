"""Foreign formats: what labs already have becomes records, and records become what other tools read."""
