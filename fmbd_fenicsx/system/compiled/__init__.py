"""The compiled evaluation of a system: generated kernels and the driver that feeds them, see ``driver/``."""
