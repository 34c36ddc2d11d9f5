"""Treadlight: the circumference of a tire tread from laser sections and specular photometry."""

__version__ = "0.1.0"
