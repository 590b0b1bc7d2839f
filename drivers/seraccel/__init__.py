"""SparkFun's serial accelerometer: the worked example of a driver (docs/protocols.md §3)."""
