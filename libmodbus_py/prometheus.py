"""Metrics for Prometheus: a short path to `services.integrations.prometheus`."""

from .services.integrations.prometheus import Collector, collect

__all__ = ["Collector", "collect"]
