"""What a study asks for, what of it is missing, and carrying that out: plans, forecasts, jobs, lanes."""
