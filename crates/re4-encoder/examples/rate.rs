//! scratch
use burn::optim::{AdamWConfig, GradientsParams};
use burn::tensor::{Device, Distribution, Tensor};
use re4_encoder::resnet::Encoder;
use std::time::Instant;
fn main() {
    let arg = |k: usize, d: usize| std::env::args().nth(k).map_or(d, |s| s.parse().unwrap());
    let (width, batch, steps) = (arg(1, 64), arg(2, 64), arg(3, 4));
    #[cfg(feature = "torch")]
    let device = Device::libtorch().autodiff();
    #[cfg(not(feature = "torch"))]
    let device = Device::flex().autodiff();
    let mut model = Encoder::new(width, &device);
    let mut optim = AdamWConfig::new().with_weight_decay(1e-4).init();
    let x = Tensor::<4>::random([batch, 3, 76, 76], Distribution::Normal(0.0, 1.0), &device);
    for i in 0..steps {
        let t = Instant::now();
        let (_, p) = model.forward(x.clone());
        let loss = p.powf_scalar(2.0).mean();
        let l: f32 = loss.clone().into_scalar();
        let f = t.elapsed();
        let g = GradientsParams::from_grads(loss.backward(), &model);
        model = optim.step(3e-4, model, g);
        let s = t.elapsed();
        println!(
            "{i} loss {l} forward {f:?} all {s:?} {:.1}/s",
            batch as f64 / s.as_secs_f64()
        );
    }
}
