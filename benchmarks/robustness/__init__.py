"""What the project stands: faults of disks, floods of messages, days of captures."""
