"""The joint least-squares adjustment of all views: parameters, residuals, normal equations, Levenberg-Marquardt."""
