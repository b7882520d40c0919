"""What is taken down while a run goes on: values of sensors, work and power, events."""
