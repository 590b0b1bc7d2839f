"""Injected faults, seeded and repeatable: on the wire, in the sensor, at the plug, in the fixes."""
