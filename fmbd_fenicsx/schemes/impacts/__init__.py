"""Schemes with contact and impacts."""
