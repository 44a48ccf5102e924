//! Until the application for boards with a power stage is there: the interrupts, and nothing done in them.

#[rtic::app(device = stm32f4xx_hal::pac, peripherals = true)]
mod app {
    use crate::board::{self, Board, Rest, SerialIn, SerialOut, Stage};
    use firmware::board::{PowerStage, SerialOutput};
    use firmware::power::Bridge;

    #[shared]
    struct Shared {}

    #[local]
    struct Local {
        rest: Rest,
        stage: Stage,
        serial_in: SerialIn,
        serial_out: SerialOut,
    }

    #[init]
    fn init(cx: init::Context) -> (Shared, Local) {
        let Board {
            stage,
            serial_in,
            serial_out,
            rest,
            ..
        } = board::set_up(cx.device);
        defmt::info!("{=str}", board::NAME);
        (
            Shared {},
            Local {
                rest,
                stage,
                serial_in,
                serial_out,
            },
        )
    }

    #[idle(local = [rest])]
    fn idle(cx: idle::Context) -> ! {
        loop {
            cx.local.rest.rest();
        }
    }

    #[task(binds = ADC, priority = 4, local = [stage])]
    fn tick(cx: tick::Context) {
        let stage = cx.local.stage;
        stage.acknowledge();
        stage.sensed();
        stage.gate_fault();
        stage.apply(Bridge::Off);
        rtic::pend(stm32f4xx_hal::pac::Interrupt::EXTI0);
    }

    #[task(binds = UART4, priority = 3, local = [serial_in])]
    fn receive(cx: receive::Context) {
        cx.local.serial_in.read();
    }

    #[task(binds = EXTI0, priority = 1, local = [serial_out])]
    fn desk(cx: desk::Context) {
        cx.local.serial_out.write(&[0]);
    }
}
