"""Speed, memory and idle cost, sagnode beside the paper's methods.

``python benchmarks/performance/run.py`` measures everything and writes it into ``docs/performance.md``.
"""
