"""What an axis is admitted to do: acceptance, forecasts, kinematics."""
