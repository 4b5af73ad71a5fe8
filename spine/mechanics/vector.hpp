// SPDX-License-Identifier: Apache-2.0
// Vectors and matrices of three.
#pragma once

#include <cmath>

#include "spine/core/rt.hpp"

namespace lithe::mechanics {

struct Vector {
  double x = 0, y = 0, z = 0;

  friend Vector operator+(const Vector& a, const Vector& b) LITHE_RT { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
  friend Vector operator-(const Vector& a, const Vector& b) LITHE_RT { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
  friend Vector operator*(double s, const Vector& a) LITHE_RT { return {s * a.x, s * a.y, s * a.z}; }
};

inline double dot(const Vector& a, const Vector& b) LITHE_RT { return a.x * b.x + a.y * b.y + a.z * b.z; }
inline Vector cross(const Vector& a, const Vector& b) LITHE_RT {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

// By rows.
struct Matrix {
  Vector x, y, z;

  Matrix transposed() const LITHE_RT { return {{x.x, y.x, z.x}, {x.y, y.y, z.y}, {x.z, y.z, z.z}}; }
  friend Vector operator*(const Matrix& m, const Vector& v) LITHE_RT { return {dot(m.x, v), dot(m.y, v), dot(m.z, v)}; }
  friend Matrix operator*(const Matrix& m, const Matrix& n) LITHE_RT {
    const Matrix columns = n.transposed();
    return {columns * m.x, columns * m.y, columns * m.z};
  }
  friend Matrix operator+(const Matrix& m, const Matrix& n) LITHE_RT { return {m.x + n.x, m.y + n.y, m.z + n.z}; }
};

inline constexpr Matrix kIdentity{{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};

// The rotation by this angle [rad] about a unit vector.
inline Matrix rotation(const Vector& axis, double angle_rad) LITHE_RT {
  const double s = std::sin(angle_rad), c = std::cos(angle_rad);
  const Vector k = (1 - c) * axis;
  return {{c + axis.x * k.x, axis.x * k.y - axis.z * s, axis.x * k.z + axis.y * s},
          {axis.y * k.x + axis.z * s, c + axis.y * k.y, axis.y * k.z - axis.x * s},
          {axis.z * k.x - axis.y * s, axis.z * k.y + axis.x * s, c + axis.z * k.z}};
}

// The inertia of a point about the origin [kg m^2].
inline Matrix inertia_of(double mass_kg, const Vector& at) LITHE_RT {
  const double square = dot(at, at);
  return {{mass_kg * (square - at.x * at.x), -mass_kg * at.x * at.y, -mass_kg * at.x * at.z},
          {-mass_kg * at.y * at.x, mass_kg * (square - at.y * at.y), -mass_kg * at.y * at.z},
          {-mass_kg * at.z * at.x, -mass_kg * at.z * at.y, mass_kg * (square - at.z * at.z)}};
}

}  // namespace lithe::mechanics
