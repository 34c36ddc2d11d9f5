"""Results held against truth; the only code that opens a capture's truth/."""
