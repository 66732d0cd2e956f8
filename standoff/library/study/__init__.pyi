from .study import plan_study as plan_study, write_study as write_study
