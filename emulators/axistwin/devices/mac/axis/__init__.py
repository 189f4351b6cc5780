"""What every MAC module is, whatever it talks on: commands, motion, stops, faults, memory."""
