// SPDX-License-Identifier: Apache-2.0
// What laws compute with Eigen: the text of this file goes into a law, and the test includes it with ordinary Eigen.
// Each function takes a number from which its matrices are made, and gives a sum over all elements of its result, each
// with a weight of its own.
#pragma once

#include <Eigen/Dense>
#include <cmath>

template <int N>
struct Operations {
  using M = Eigen::Matrix<double, N, N>;
  using V = Eigen::Matrix<double, N, 1>;
  using RowMajor = Eigen::Matrix<double, N, N, Eigen::RowMajor>;
  using Tall = Eigen::Matrix<double, N, 3>;

  static M general(double seed) {
    M made;
    for (int i = 0; i < N; ++i)
      for (int j = 0; j < N; ++j) made(i, j) = std::sin(seed * (i + 1) + 1.7 * j * j + i) + (i == j ? 3 : 0);
    return made;
  }
  static M positive(double seed) {
    M made;
    const M part = general(seed);
    for (int i = 0; i < N; ++i)
      for (int j = 0; j < N; ++j) made(i, j) = part.row(i).dot(part.row(j)) + (i == j ? 1 : 0);
    return made;
  }
  static V vector(double seed) { return general(seed + 1).col(N - 1); }
  template <class Result>
  static double sum(const Result& result) {
    double total = 0;
    for (int i = 0; i < result.rows(); ++i)
      for (int j = 0; j < result.cols(); ++j) total += std::cos(1.3 * i + 2.9 * j) * result(i, j);
    return total;
  }

  static double product(double seed) {
    const M a = general(seed), b = general(seed + 2);
    const RowMajor c = a * b.transpose();
    return sum(M(c * a)) + sum(V(a * vector(seed))) + (c * b).trace();
  }
  static double blocks(double seed) {  // of sizes that are known at run time only
    const M a = general(seed);
    const int n = N - 1 - (seed > 1e6 ? 1 : 0);
    M result = M::Zero();
    result.topLeftCorner(n, n) = a.topLeftCorner(n, 2) * a.bottomRightCorner(2, n);
    result.col(0).head(n).noalias() += a.topRightCorner(n, n) * a.row(1).head(n).transpose();
    return sum(result);
  }
  static double triangles(double seed) {
    const M a = general(seed), b = general(seed + 2);
    M result = a.template triangularView<Eigen::Lower>() * b;
    result += b * a.template triangularView<Eigen::UnitUpper>();
    result += a.transpose().template triangularView<Eigen::StrictlyUpper>() * b;
    result.col(0) += a.template triangularView<Eigen::Upper>() * b.col(1);
    result += RowMajor(a).template triangularView<Eigen::Lower>() * RowMajor(b);
    return sum(result);
  }
  static double symmetric(double seed) {
    const M a = positive(seed), b = general(seed);
    M result = a.template selfadjointView<Eigen::Lower>() * b;
    result += b * a.template selfadjointView<Eigen::Upper>();
    result.col(0) += 0.5 * (a.template selfadjointView<Eigen::Lower>() * b.col(1));
    M half = M::Zero();
    half.template selfadjointView<Eigen::Lower>().rankUpdate(b, 2.0);
    half.template selfadjointView<Eigen::Lower>().rankUpdate(b.col(0));
    half.template triangularView<Eigen::StrictlyUpper>() = a * b;
    return sum(result) + sum(half);
  }
  static double triangular_solve(double seed) {
    const M a = general(seed), b = general(seed + 2);
    M x = a.template triangularView<Eigen::Lower>().solve(b);
    x += a.template triangularView<Eigen::Upper>().template solve<Eigen::OnTheRight>(b);
    x += a.transpose().template triangularView<Eigen::UnitLower>().solve(b) * 1e-3;
    x.col(0) += a.template triangularView<Eigen::Upper>().solve(b.col(0));
    x += RowMajor(a).template triangularView<Eigen::Lower>().solve(RowMajor(b));
    return sum(x);
  }
  static double lu(double seed) {
    const M a = general(seed);
    return sum(V(a.partialPivLu().solve(vector(seed)))) + sum(M(a.partialPivLu().solve(general(seed + 2)))) +
           a.determinant() * 1e-3;
  }
  static double full_lu(double seed) { return sum(V(general(seed).fullPivLu().solve(vector(seed)))); }
  static double inverse(double seed) { return sum(M(general(seed).inverse())); }
  static double llt(double seed) {
    const Eigen::LLT<M> made(positive(seed));
    return sum(V(made.solve(vector(seed)))) + sum(M(made.solve(general(seed)))) + sum(M(made.matrixL()));
  }
  static double ldlt(double seed) { return sum(V(positive(seed).ldlt().solve(vector(seed)))); }
  static double qr(double seed) {
    const Eigen::HouseholderQR<M> made(general(seed));
    const M q = made.householderQ();
    return sum(V(made.solve(vector(seed)))) + sum(q);
  }
  static double pivoted_qr(double seed) { return sum(V(general(seed).colPivHouseholderQr().solve(vector(seed)))); }
  static double svd(double seed) {
    const Eigen::JacobiSVD<M> made(general(seed), Eigen::ComputeFullU | Eigen::ComputeFullV);
    return sum(made.singularValues()) + sum(V(made.solve(vector(seed))));
  }
  static double tall_svd(double seed) {
    const Tall a = general(seed).template leftCols<3>();
    const Eigen::JacobiSVD<Tall> made(a, Eigen::ComputeFullU | Eigen::ComputeFullV);
    return sum(made.singularValues()) + sum(made.solve(vector(seed)).eval());
  }
  static double eigenvalues(double seed) {
    const Eigen::SelfAdjointEigenSolver<M> made(positive(seed));
    const M back = made.eigenvectors() * made.eigenvalues().cwiseSqrt().asDiagonal() * made.eigenvectors().transpose();
    return sum(made.eigenvalues()) + sum(back);
  }
  static double geometry(double seed) {
    const Eigen::Quaterniond q(Eigen::AngleAxisd(seed, Eigen::Vector3d(1, 2, 3).normalized()));
    Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
    pose.rotate(q.slerp(0.3, Eigen::Quaterniond::Identity())).translate(Eigen::Vector3d(seed, 2, 1));
    const Eigen::Matrix3d turn = q.toRotationMatrix() * pose.inverse().linear();
    return sum(turn) + sum((pose * Eigen::Vector3d(1, seed, 0)).eval()) + pose.rotation().eulerAngles(2, 1, 0).sum();
  }
};
