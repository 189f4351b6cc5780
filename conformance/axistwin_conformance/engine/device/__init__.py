"""The device during a run: guarded, judged, asked for its readings, restored."""
