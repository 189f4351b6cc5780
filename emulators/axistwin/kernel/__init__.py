"""The ground everything stands on: time, event order, effects, seeds.  Standard library only."""
