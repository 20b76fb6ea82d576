"""Temporary."""
from __future__ import annotations
from dataclasses import dataclass, field
import time, numpy as np, highspy
from scipy import sparse
@dataclass
class CoverProblem:
    matrix: sparse.csr_matrix; costs: np.ndarray; groups: np.ndarray|None=None; at_least: int=1
@dataclass
class Cover:
    status:str; chosen:np.ndarray; objective:float; bound:float; gap:float; seconds_cpu:float; uncoverable:list=field(default_factory=list); reductions:dict=field(default_factory=dict)
def solve_cover_problem(p,time_limit_s=300,seed=1):
    from scipy.optimize import milp, LinearConstraint, Bounds
    t=time.process_time()
    A=p.matrix.astype(float).T.tocsr(); _,u=np.unique([A[i].indices.tobytes() for i in range(A.shape[0])],return_index=True); A=A[np.sort(u)]
    r=milp(p.costs,constraints=LinearConstraint(A,lb=p.at_least),integrality=np.ones(A.shape[1]),bounds=Bounds(0,1),options=dict(time_limit=time_limit_s,mip_rel_gap=0.05))
    ch=np.flatnonzero(r.x>.5); b=np.ceil(r.mip_dual_bound-1e-6)
    return Cover('optimal' if b>=len(ch) else 'time_limit',ch,float(len(ch)),float(b),float((len(ch)-b)/len(ch)),time.process_time()-t)
