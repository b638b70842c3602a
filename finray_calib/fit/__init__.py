"""From band values to the posterior of a paint's emission."""
