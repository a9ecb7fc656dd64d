"""
Metrics for Prometheus: a short path to `services.integrations.prometheus`.
"""

from .services.integrations.prometheus import Collector as Collector
from .services.integrations.prometheus import collect as collect

__all__ = ["Collector", "collect"]
