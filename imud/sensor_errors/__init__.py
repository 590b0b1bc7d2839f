"""What is known of a sensor's errors: noise profiles, calibrations kept by serial number, and how both are found."""
