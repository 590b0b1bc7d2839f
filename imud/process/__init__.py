"""The process and its system: signals, memory, priorities, log, service manager."""
