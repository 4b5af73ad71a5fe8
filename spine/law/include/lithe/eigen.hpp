// SPDX-License-Identifier: Apache-2.0
// Eigen for laws: matrices of fixed size, without heap memory. The compile service includes it before a law that
// includes <Eigen/...>; a law does not include it itself.
//
// Eigen 3.4 computes even a product of 9 x 9 with kernels for large matrices: they allocate blocks, keep the sizes of
// the caches in a variable, and take seconds to compile. Here plain loops stand for them. A constraint (`requires
// true`) makes a template more special than Eigen's own of the same arguments, so that Eigen takes this one.
#pragma once

#include "lithe/law.hpp"

#define EIGEN_NO_DEBUG  // a failed assertion would print and abort
#define EIGEN_DONT_PARALLELIZE
#define EIGEN_CACHEFRIENDLY_PRODUCT_THRESHOLD 1000000  // from this size on a kernel for large matrices
#include <Eigen/Core>

namespace Eigen {
namespace internal {

// Products are sums, also those of blocks whose size is known at run time only.
template <class Lhs, class Rhs>
  requires true
struct generic_product_impl<Lhs, Rhs, DenseShape, DenseShape, GemmProduct>
    : generic_product_impl<Lhs, Rhs, DenseShape, DenseShape, CoeffBasedProductMode> {};
template <class Lhs, class Rhs>
  requires true
struct generic_product_impl<Lhs, Rhs, DenseShape, DenseShape, GemvProduct>
    : generic_product_impl<Lhs, Rhs, DenseShape, DenseShape, CoeffBasedProductMode> {};

// Solves triangle * x = x, column by column, or x * triangle = x, row by row.
template <class Triangle, class X, int side, int mode>
struct PlainSolver {
  static void run(const Triangle& triangle, X& x) {
    constexpr bool kLeft = side == OnTheLeft, kForward = ((mode & Lower) != 0) == kLeft;
    const Index size = triangle.rows(), others = kLeft ? x.cols() : x.rows();
    for (Index other = 0; other < others; ++other) {
      const auto at = [&](Index i) ->
          typename X::Scalar& { return kLeft ? x.coeffRef(i, other) : x.coeffRef(other, i); };
      for (Index n = 0; n < size; ++n) {
        const Index i = kForward ? n : size - 1 - n;
        for (Index k = kForward ? 0 : i + 1; k < (kForward ? i : size); ++k)
          at(i) -= (kLeft ? triangle.coeff(i, k) : triangle.coeff(k, i)) * at(k);
        if constexpr ((mode & UnitDiag) == 0) at(i) /= triangle.coeff(i, i);
      }
    }
  }
};
template <class Triangle, class X, int side, int mode>
  requires true
struct triangular_solver_selector<Triangle, X, side, mode, NoUnrolling, 1> : PlainSolver<Triangle, X, side, mode> {};
template <class Triangle, class X, int side, int mode>
  requires true
struct triangular_solver_selector<Triangle, X, side, mode, NoUnrolling, Dynamic>
    : PlainSolver<Triangle, X, side, mode> {};

// An element of the matrix that a triangular or symmetric view means: `mode` says which half of `of` it has.
template <int mode, class Matrix>
typename Matrix::Scalar viewed(const Matrix& of, Index i, Index j) {
  typedef typename Matrix::Scalar Scalar;
  constexpr bool kLower = (mode & Lower) != 0;
  if constexpr (mode == 0)
    return of.coeff(i, j);
  else if (i == j && (mode & (UnitDiag | ZeroDiag)) != 0)
    return Scalar((mode & UnitDiag) != 0 ? 1 : 0);
  else if (i == j && (mode & SelfAdjoint) != 0)
    return Scalar(numext::real(of.coeff(i, i)));
  else if (i == j || (i > j) == kLower)
    return of.coeff(i, j);
  else
    return (mode & SelfAdjoint) != 0 ? numext::conj(of.coeff(j, i)) : Scalar(0);
}

// to += factor * left * right
template <class Left, int left_mode, class Right, int right_mode>
struct PlainProduct {
  template <class To>
  static void run(To& to, const Left& left_expression, const Right& right_expression,
                  const typename To::Scalar& factor) {
    const typename nested_eval<Left, Dynamic>::type left(left_expression);
    const typename nested_eval<Right, Dynamic>::type right(right_expression);
    for (Index j = 0; j < to.cols(); ++j) {
      for (Index i = 0; i < to.rows(); ++i) {
        typename To::Scalar sum(0);
        for (Index k = 0; k < left.cols(); ++k) sum += viewed<left_mode>(left, i, k) * viewed<right_mode>(right, k, j);
        to.coeffRef(i, j) += factor * sum;
      }
    }
  }
};
template <int mode, class Left, class Right>
  requires true
struct triangular_product_impl<mode, true, Left, false, Right, true> : PlainProduct<Left, mode, Right, 0> {};
template <int mode, class Left, class Right>
  requires true
struct triangular_product_impl<mode, false, Left, true, Right, false> : PlainProduct<Left, 0, Right, mode> {};
template <int mode, bool is_left, class Left, class Right>
  requires true
struct triangular_product_impl<mode, is_left, Left, false, Right, false>
    : PlainProduct<Left, is_left ? mode : 0, Right, is_left ? 0 : mode> {};
template <class Left, int mode, class Right>
  requires true
struct selfadjoint_product_impl<Left, mode, false, Right, 0, true> : PlainProduct<Left, mode, Right, 0> {};
template <class Left, class Right, int mode>
  requires true
struct selfadjoint_product_impl<Left, 0, true, Right, mode, false> : PlainProduct<Left, 0, Right, mode> {};
template <class Left, int left_mode, class Right, int right_mode>
  requires true
struct selfadjoint_product_impl<Left, left_mode, false, Right, right_mode, false>
    : PlainProduct<Left, left_mode, Right, right_mode> {};

// One reflection after the other; Eigen gathers them in blocks.
template <class Matrix, class Vectors, class Coefficients>
  requires true
void apply_block_householder_on_the_left(Matrix& matrix, const Vectors& vectors, const Coefficients& coefficients,
                                         bool forward) {
  for (Index n = 0; n < vectors.cols(); ++n) {
    const Index v = forward ? vectors.cols() - 1 - n : n;
    for (Index j = 0; j < matrix.cols(); ++j) {
      typename Matrix::Scalar sum = matrix.coeff(v, j);
      for (Index i = v + 1; i < matrix.rows(); ++i) sum += numext::conj(vectors.coeff(i, v)) * matrix.coeff(i, j);
      sum *= forward ? coefficients.coeff(v) : numext::conj(coefficients.coeff(v));
      matrix.coeffRef(v, j) -= sum;
      for (Index i = v + 1; i < matrix.rows(); ++i) matrix.coeffRef(i, j) -= vectors.coeff(i, v) * sum;
    }
  }
}

}  // namespace internal

// One half of `to`: = or += factor * left * right, where `right` of a rank update is the adjoint of `left`.
template <class To, class Product, int half>
struct PlainHalf {
  static void run(To& to, const Product& product, const typename To::Scalar& factor, bool add) {
    const typename internal::nested_eval<typename Product::Lhs, Dynamic>::type left(product.lhs());
    const typename internal::nested_eval<typename Product::Rhs, Dynamic>::type right(product.rhs());
    constexpr bool kLower = (half & Lower) != 0;
    for (Index j = 0; j < to.cols(); ++j) {
      for (Index i = kLower ? j : 0; i < (kLower ? to.rows() : j + 1); ++i) {
        if ((half & ZeroDiag) != 0 && i == j) continue;
        typename To::Scalar sum(0);
        for (Index k = 0; k < left.cols(); ++k) sum += left.coeff(i, k) * right.coeff(k, j);
        to.coeffRef(i, j) = (add ? to.coeff(i, j) : typename To::Scalar(0)) + factor * sum;
      }
    }
  }
};
template <class To, class Product, int half>
  requires true
struct general_product_to_triangular_selector<To, Product, half, true> : PlainHalf<To, Product, half> {};
template <class To, class Product, int half>
  requires true
struct general_product_to_triangular_selector<To, Product, half, false> : PlainHalf<To, Product, half> {};

template <class To, class Other, int half>
struct PlainRankUpdate {
  static void run(To& to, const Other& other, const typename To::Scalar& factor) {
    const auto product = other.lazyProduct(other.adjoint());
    PlainHalf<To, std::remove_const_t<decltype(product)>, half>::run(to, product, factor, true);
  }
};
template <class To, class Other, int half>
  requires true
struct selfadjoint_product_selector<To, Other, half, true> : PlainRankUpdate<To, Other, half> {};
template <class To, class Other, int half>
  requires true
struct selfadjoint_product_selector<To, Other, half, false> : PlainRankUpdate<To, Other, half> {};

}  // namespace Eigen

#include <Eigen/Dense>

namespace Eigen::internal {

template <class Matrix, class Coefficients, class Scalar, bool dense>
  requires true
struct householder_qr_inplace_blocked<Matrix, Coefficients, Scalar, dense> {
  static void run(Matrix& matrix, Coefficients& coefficients, Index, Scalar* row = nullptr) {
    householder_qr_inplace_unblocked(matrix, coefficients, row);
  }
};

}  // namespace Eigen::internal
