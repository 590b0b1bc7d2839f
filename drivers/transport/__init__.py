"""Ports: serial lines, SPI, the kernel's devices, connections and recordings; dialogues are run on them."""
