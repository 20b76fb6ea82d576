// Times and names of steps as people read them.

export function duration(seconds) {
  if (seconds < 1) return "< 1 s";
  if (seconds < 90) return `${Math.round(seconds)} s`;
  if (seconds < 5400) return `${Math.round(seconds / 60)} min`;
  return `${(seconds / 3600).toFixed(1)} h`;
}

// A step: its rule, and of what.
export function stepName({ rule, wildcards }) {
  const of = Object.values(wildcards).join(" ");
  return of ? `${rule} (${of})` : rule;
}
