"""The thesis as it stands, not sound: its examples, its printed conditions, and ERRATA.md. Nothing sound imports it."""
