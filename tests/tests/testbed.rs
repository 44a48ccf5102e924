use control::criterion::Device;
use control::encoder::EncoderConfig;
use control::spring::Side;
use control::tick::{Config, Law};
use plant_sim::closed_loop::Scene;
use plant_sim::hold::State;

#[test]
fn probe() {
    for (k, counts, v) in [
        (0.015, 8192.0, 30.0),
        (0.015, 20.0, 12.0),
        (1.0, 8192.0, 3.0),
        (1.0, 8192.0, 7.0),
        (0.5195, 8192.0, 9.99),
        (0.5195, 8192.0, 10.01),
    ] {
        let device = Device {
            inertia_kg_m2: 6.28e-6,
            viscous_nm_s_rad: 9e-6,
            coulomb_nm: 2e-3,
        };
        let scene = Scene {
            device,
            config: Config {
                device,
                period_s: 1e-3,
                hardware_count_rad: std::f64::consts::TAU / counts,
                encoder: EncoderConfig::new(32, 1).unwrap(),
                side: Side::Both,
                zero_rad: 0.0,
                stiffness_nm_rad: k,
                law: Law::Raw,
            },
            start: State {
                position: 1e-9,
                velocity: v,
            },
            samples: 40_000,
        };
        println!("{:#?}", scene.run(|_| true));
    }
}
