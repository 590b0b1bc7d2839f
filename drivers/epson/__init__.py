"""Epson's inertial sensors, M-G350 and its relatives, on UART and SPI (docs/protocols.md §1)."""
