"""Framed exchange with devices: every one with a deadline and a transcript."""
