"""Joints: elementary constraints, joint coordinates, drives, ties."""
