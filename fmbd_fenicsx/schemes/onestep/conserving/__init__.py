"""Energy-momentum: difference quotients in place of derivatives."""
