"""Estimators: one file a part."""
