// Names that session commands may carry.

/// A reference's name out of what somebody typed.
export function plainName(text: string): string {
  return text.trim().normalize("NFKD").replace(/[\u0300-\u036f]/g, "").toLowerCase()
    .replace(/[^a-z0-9_-]+/g, "_").replace(/^[_-]+|_+$/g, "").slice(0, 64);
}
