"""Jobs of many pairs: job files, plans of tasks, and their execution."""

from cagemap.jobs.consistency import Consistency, measure_consistency
from cagemap.jobs.job import Job, read_job
from cagemap.jobs.job_schema import Asset, OutputRule, PairRule
from cagemap.jobs.page import pair_rows, write_library
from cagemap.jobs.plan import Plan, Task, plan_job
from cagemap.jobs.run import TaskOutcome, missing_tasks, open_client, run_plan
from cagemap.jobs.tree import spanning_tree

__all__ = [
    "Asset",
    "Consistency",
    "Job",
    "OutputRule",
    "PairRule",
    "Plan",
    "Task",
    "TaskOutcome",
    "measure_consistency",
    "missing_tasks",
    "open_client",
    "pair_rows",
    "plan_job",
    "read_job",
    "run_plan",
    "spanning_tree",
    "write_library",
]
