//! Kalman filters for linear models: the steady-state filter, whose gain is
//! constant, and the time-varying filter, which computes a gain in each step
//! (thesis 7.2.5, Figure 7.10).

use crate::linear::{is_finite, is_positive, is_symmetric, solve, symmetric_part};
use crate::lqr::{RegulatorError, dlqr};
use crate::model::{Continuous, Discrete};
use crate::scalar::Scalar;
use nalgebra::{SMatrix, SVector};

/// Why no filter exists, or why a step of it failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum KalmanError {
    /// An entry of F, G or H is NaN or infinite.
    ModelNotFinite,
    /// The process noise is not finite, symmetric and positive semidefinite.
    ProcessNoise,
    /// The measurement noise is not finite, symmetric and positive definite.
    MeasurementNoise,
    /// The system is not detectable: the measurements do not observe a mode
    /// that does not decay.
    NotDetectable,
    /// The process noise does not drive a mode on the unit circle, such as a
    /// constant bias: the longer it is measured, the better it is known, so that its
    /// gain falls towards zero and no constant gain is right.
    NoiseFreeMode,
    /// The data are too badly conditioned for a reliable gain.
    IllConditioned,
    /// A measurement is NaN or infinite. The filter is unchanged.
    MeasurementNotFinite,
    /// An input of the model is NaN or infinite. The filter is unchanged.
    InputNotFinite,
    /// The estimate or its covariance is NaN or infinite, or would become so. The filter is unchanged.
    EstimateNotFinite,
}

impl core::fmt::Display for KalmanError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::ModelNotFinite => "an entry of F, G or H is not a finite number",
            Self::ProcessNoise => "the process noise is not symmetric and positive semidefinite",
            Self::MeasurementNoise => {
                "the measurement noise is not symmetric and positive definite"
            }
            Self::NotDetectable => "the measurements do not observe a mode that does not decay",
            Self::NoiseFreeMode => {
                "a mode that neither grows nor decays has no process noise, \
                 so its gain has no steady state but zero"
            }
            Self::IllConditioned => "the data are too badly conditioned for a reliable gain",
            Self::MeasurementNotFinite => "a measurement is not a finite number",
            Self::InputNotFinite => "an input of the model is not a finite number",
            Self::EstimateNotFinite => "the estimate or its covariance is not a finite number",
        })
    }
}

impl core::error::Error for KalmanError {}

/// A steady-state filter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SteadyState<T, const N: usize, const P: usize> {
    /// Gain on the innovation, N x P, for x <- x + K (z - H x).
    pub gain: SMatrix<T, N, P>,
    /// Covariance before the measurement, N x N.
    pub predicted: SMatrix<T, N, N>,
    /// Covariance after the measurement, N x N.
    pub corrected: SMatrix<T, N, N>,
}

/// The steady-state Kalman filter for x' = F x + w, z = H x + v with covariances
/// `q` (N x N) of w and `r` (P x P) of v. It is computed as the dual of the
/// linear quadratic regulator, so that every mode of the error F (I - K H)
/// decays. Every mode of F that does not decay must be observable, and the
/// process noise must drive every mode on the unit circle. For a constant, such as
/// a bias, let `q` say by how much it may wander, or use [`Kalman`], whose gain
/// falls with the number of measurements. An unstable mode needs no noise.
///
/// # Errors
/// [`KalmanError`] names the matrix or the condition at fault.
pub fn steady_state<T: Scalar, const N: usize, const P: usize>(
    f: &SMatrix<T, N, N>,
    h: &SMatrix<T, P, N>,
    q: &SMatrix<T, N, N>,
    r: &SMatrix<T, P, P>,
) -> Result<SteadyState<T, N, P>, KalmanError> {
    let dual = Discrete {
        f: f.transpose(),
        g: h.transpose(),
    };
    let regulator = dlqr(&dual, q, r).map_err(|error| match error {
        RegulatorError::ModelNotFinite => KalmanError::ModelNotFinite,
        RegulatorError::StateWeight => KalmanError::ProcessNoise,
        RegulatorError::InputWeight => KalmanError::MeasurementNoise,
        RegulatorError::NotStabilisable => KalmanError::NotDetectable,
        RegulatorError::UnweightedMode => KalmanError::NoiseFreeMode,
        RegulatorError::IllConditioned => KalmanError::IllConditioned,
    })?;
    let predicted = regulator.cost;
    let gain = gain_of(&predicted, h, r).ok_or(KalmanError::IllConditioned)?;
    Ok(SteadyState {
        gain,
        predicted,
        corrected: joseph(&predicted, &gain, h, r),
    })
}

/// A time-varying filter: an estimate of N states and its covariance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Kalman<T, const N: usize> {
    /// The estimate.
    pub state: SVector<T, N>,
    /// Its covariance.
    pub covariance: SMatrix<T, N, N>,
}

impl<T: Scalar, const N: usize> Kalman<T, N> {
    /// Time update: advances the estimate by one period of `model` with input
    /// `u`. `q` (N x N, positive semidefinite) is the covariance of the process noise over the period.
    ///
    /// # Errors
    /// [`KalmanError`] names the input at fault. The filter is then unchanged.
    pub fn predict<const M: usize>(
        &mut self,
        model: &Discrete<T, N, M>,
        u: &SVector<T, M>,
        q: &SMatrix<T, N, N>,
    ) -> Result<(), KalmanError> {
        if !(is_finite(&model.f) && is_finite(&model.g)) {
            return Err(KalmanError::ModelNotFinite);
        }
        if !is_finite(u) {
            return Err(KalmanError::InputNotFinite);
        }
        if !(is_finite(q) && is_symmetric(q) && is_positive(q, false)) {
            return Err(KalmanError::ProcessNoise);
        }
        self.become_finite(Self {
            state: model.f * self.state + model.g * u,
            covariance: symmetric_part(&(model.f * self.covariance * model.f.transpose() + q)),
        })
    }

    /// Takes what follows from a step, unless it is not finite.
    fn become_finite(&mut self, next: Self) -> Result<(), KalmanError> {
        if !(is_finite(&next.state) && is_finite(&next.covariance)) {
            return Err(KalmanError::EstimateNotFinite);
        }
        *self = next;
        Ok(())
    }

    /// Measurement update by `z` = `h` x + v, where v has the covariance `r`
    /// (P x P). The covariance is updated in Joseph's form, which keeps it
    /// positive semidefinite.
    ///
    /// # Errors
    /// [`KalmanError`] names the input at fault. The filter is then unchanged.
    pub fn correct<const P: usize>(
        &mut self,
        z: &SVector<T, P>,
        h: &SMatrix<T, P, N>,
        r: &SMatrix<T, P, P>,
    ) -> Result<(), KalmanError> {
        if !is_finite(z) {
            return Err(KalmanError::MeasurementNotFinite);
        }
        if !is_finite(h) {
            return Err(KalmanError::ModelNotFinite);
        }
        if !(is_finite(r) && is_symmetric(r) && is_positive(r, true)) {
            return Err(KalmanError::MeasurementNoise);
        }
        if !(is_finite(&self.state) && is_finite(&self.covariance)) {
            return Err(KalmanError::EstimateNotFinite);
        }
        let gain = gain_of(&self.covariance, h, r).ok_or(KalmanError::IllConditioned)?;
        self.become_finite(Self {
            state: self.state + gain * (z - h * self.state),
            covariance: joseph(&self.covariance, &gain, h, r),
        })
    }
}

/// P H' (H P H' + R)^-1, solved from the transposed equation.
fn gain_of<T: Scalar, const N: usize, const P: usize>(
    covariance: &SMatrix<T, N, N>,
    h: &SMatrix<T, P, N>,
    r: &SMatrix<T, P, P>,
) -> Option<SMatrix<T, N, P>> {
    let cross = h * covariance;
    let spread = symmetric_part(&(cross * h.transpose() + r));
    solve(spread, cross).map(|gain| gain.transpose())
}

/// (I - K H) P (I - K H)' + K R K'.
fn joseph<T: Scalar, const N: usize, const P: usize>(
    covariance: &SMatrix<T, N, N>,
    gain: &SMatrix<T, N, P>,
    h: &SMatrix<T, P, N>,
    r: &SMatrix<T, P, P>,
) -> SMatrix<T, N, N> {
    let rest = SMatrix::<T, N, N>::identity() - gain * h;
    symmetric_part(&(rest * covariance * rest.transpose() + gain * r * gain.transpose()))
}

/// The steering model extended by constant biases of the heading and steering
/// angle measurements (thesis Figure 7.11). The five states are cross-track
/// error (m), heading error, steering angle, heading bias and steering bias
/// (rad). Returns the model and the 3 x 5 measurement matrix.
///
/// It is observable while the vehicle moves. At standstill only the sums of an
/// angle and its bias are observable.
#[must_use]
pub fn with_biases<T: Scalar>(
    model: &Continuous<T, 3, 1>,
) -> (Continuous<T, 5, 1>, SMatrix<T, 3, 5>) {
    let mut a = SMatrix::<T, 5, 5>::zeros();
    a.fixed_view_mut::<3, 3>(0, 0).copy_from(&model.a);
    let mut b = SMatrix::<T, 5, 1>::zeros();
    b.fixed_view_mut::<3, 1>(0, 0).copy_from(&model.b);
    let mut c = SMatrix::<T, 3, 5>::zeros();
    c[(0, 0)] = T::one();
    c[(1, 1)] = T::one();
    c[(1, 3)] = T::one();
    c[(2, 2)] = T::one();
    c[(2, 4)] = T::one();
    (Continuous { a, b }, c)
}
