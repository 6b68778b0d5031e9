"""Wahba's problem, the attitude with its covariance, and its prediction."""
