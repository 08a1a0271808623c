"""What takes offered packets and says what arrives where."""
